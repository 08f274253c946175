"""What `outliers=drop` catches of mixed and flying pixels and floaters, and what it loses, on scans with truth.

    python benchmarks/outliers.py FOLDER_OF_SCANS [--simulate KIND,KIND --seeds 2 --points 25000]

"Caught" is the share of the points that belong to no surface and are off by more than three standard deviations.
"Lost" are shares of the other points, of thin parts and of the rest. The position of the sensor is given where the
files of such scanners tell it: depth frames and terrestrial scans.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from pcdnf.geometry.outliers import outlier_rows
from pcdnf.scanners.catalog import simulate
from pcdnf.scanners.scan import Scan, load_scan
from pcdnf.scanners.surface import Surface

TOLD = ("rgbd", "tls", "depth-frame", "terrestrial")
"""Beginnings of the names of scans whose sensor is known."""
FIRST_SEED = 3_000_001
OFF = 3.0


def share(found: np.ndarray, among: np.ndarray) -> str:
    return f"{100 * found[among].mean():.2f}" if among.any() else "-"


def line(name: str, scan: Scan) -> str:
    """Return a row of the table: before, with the sensor where it is told, without it."""
    far = Surface(scan.scene).nearest(scan.points).distance > OFF * scan.sigma
    off = scan.mixed & far & ~scan.scene.loose[scan.part]
    parts = (off, ~scan.mixed & ~scan.thin, ~scan.mixed & scan.thin)
    cells = [name, f"{int(off.sum())}"]
    for sensors in (scan.sensors[scan.station] if name.startswith(TOLD) else None, None):
        found, began = np.zeros(len(scan.points), bool), time.process_time()
        found[outlier_rows(scan.points, sensors)] = True
        cells += [*(share(found, part) for part in parts), f"{time.process_time() - began:.1f}"]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", help="of .npz scans with truth")
    parser.add_argument("--simulate", default="", metavar="KIND,KIND")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--points", type=int, default=25_000)
    options = parser.parse_args()
    print("| scan | off | caught % | lost % | lost thin % | s | no sensor: caught % | lost % | lost thin % | s |")
    print("|" + "---|" * 10)
    for path in sorted(options.folder.glob("*.npz")) if options.folder else ():
        print(line(path.stem, load_scan(path)), flush=True)
    for kind in filter(None, options.simulate.split(",")):
        for seed in range(FIRST_SEED, FIRST_SEED + options.seeds):
            print(line(f"{kind}-{seed}", simulate(kind, seed, options.points)), flush=True)


if __name__ == "__main__":
    main()

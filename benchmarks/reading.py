"""Processor time and memory of reading, of this tree beside another one, in turns.

    python benchmarks/reading.py FOLDER_OF_ANOTHER_TREE [--points 400000] [--runs 7]

Each reading is a process of its own. The time is of the processor, the least of the runs; the memory is what the peak
of the process grows by. Ratios are this tree to the other one.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from pcdnf.formats import PointCloud, write

HERE = Path(__file__).resolve().parents[1]
FORMATS = ("ply", "pcd", "laz", "e57", "xyz")
SINGLE = ("ply", "pcd")
"""Formats whose files mostly hold float32."""
CHILD = """
import json, pathlib, sys, time
import numpy as np
from pcdnf.formats import read
if sys.argv[1].endswith("e57"):
    import pye57
if sys.argv[1].endswith("laz"):
    import lazrs
def peak():
    lines = pathlib.Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
before, began = peak(), time.process_time()
cloud = read(sys.argv[1])
print(json.dumps([len(cloud), time.process_time() - began, (peak() - before) / 1024]))
"""


def sample(count: int, kind: str) -> PointCloud:
    """Return a wavy surface with colours, intensity and normals, its coordinates of a type of numpy."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 100, (2, count))
    normals = rng.normal(size=(count, 3)).astype(np.float32)
    points = np.stack([x, y, np.sin(x) + 0.01 * rng.normal(size=count)], axis=1).round(4)
    return PointCloud(
        points=points.astype(kind),
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        attributes={
            **{name: rng.integers(0, 256, count).astype(np.uint8) for name in ("red", "green", "blue")},
            "intensity": rng.integers(0, 65536, count).astype(np.uint16),
        },
    )


def measured(tree: Path, path: Path, count: int) -> tuple[float, float]:
    """Return seconds of the processor and MiB of one reading by the code of a tree."""
    environment = os.environ | {"PYTHONPATH": str(tree)}
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(path)], env=environment, capture_output=True, text=True, check=True, cwd=tree
    )
    found, seconds, memory = json.loads(done.stdout)
    if found != count:
        raise SystemExit(f"{tree} reads {found} of {count} points of {path.name}")
    return seconds, memory


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path, help="folder of another tree of this repository")
    parser.add_argument("--points", type=int, default=400_000)
    parser.add_argument("--runs", type=int, default=7)
    given = parser.parse_args()
    print("| file | seconds, other | seconds | ratio | MiB, other | MiB | ratio |\n|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        for ending in FORMATS:
            path = Path(name) / f"cloud.{ending}"
            write(path, sample(given.points, "f4" if ending in SINGLE else "f8"), format=ending)
            runs = [[measured(tree, path, given.points) for tree in (given.other, HERE)] for _ in range(given.runs)]
            (old, now), (much, more) = ([min(run[tree][kind] for run in runs) for tree in (0, 1)] for kind in (0, 1))
            print(
                f"| {ending} | {old:.3f} | {now:.3f} | {now / old:.2f} | {much:.0f} | {more:.0f} | {more / much:.2f} |"
            )


if __name__ == "__main__":
    main()

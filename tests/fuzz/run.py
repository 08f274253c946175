"""Many changed files of every format against the readers: ``python -m tests.fuzz.run --cases 20000``.

Each batch is read by a process of its own under limits of memory and time. Nothing may happen but a cloud that can be
written again, or a FormatError: no signal, no hang, no other exception, no memory over the cap. The files of a batch
that breaks this are kept, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from tests.support.seeds import KINDS, mutant, seed

MEMORY_BYTES = 256 * 1024**2
SECONDS = 120
BATCH = 250

CHILD = """
import json, resource, sys
import numpy as np
from pcdnf.formats import FormatError, Limits, read, write
cap = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize() + int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_AS, (cap, cap))
outcomes = {}
for index in range(int(sys.argv[3])):
    print(index, file=sys.stderr, flush=True)
    try:
        cloud = read(f"{sys.argv[1]}/{index}", limits=Limits(max_points=100_000, max_bytes=10**7), text=True)
        assert np.isfinite(cloud.points).all()
        code = "read"
        if cloud.flavour.format != "pcd" or cloud.flavour.encoding != "binary_compressed":  # whose writer compiles
            write(f"{sys.argv[1]}/out", cloud.replaced(cloud.points, cloud.normals, metadata={"seed": "0"}))
            assert len(read(f"{sys.argv[1]}/out", text=True)) == len(cloud)
    except FormatError as error:
        code = error.code
    outcomes[code] = outcomes.get(code, 0) + 1
print(json.dumps(outcomes))
"""


def run_batch(folder: Path, count: int) -> tuple[Counter[str], str]:
    """Read the files ``0`` to ``count - 1`` of a folder; the outcomes by code, and what broke the rule."""
    command = [sys.executable, "-c", CHILD, str(folder), str(MEMORY_BYTES), str(count)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS)
    except subprocess.TimeoutExpired as error:
        return Counter(), f"took more than {SECONDS} s: {(error.stderr or b'')[-200:]!r}"
    if done.returncode != 0:
        return Counter(), f"status {done.returncode}: {done.stderr[-2000:]}"
    return Counter(json.loads(done.stdout)), ""


def make_batch(folder: Path, data: bytes, count: int, rng: np.random.Generator) -> None:
    """Write changed copies of a seed."""
    for index in range(count):
        (folder / str(index)).write_bytes(mutant(data, rng))


def main() -> int:
    """Run the cases in turn over the formats; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-failures"), help="where files that break the rule go")
    given = parser.parse_args()
    began = time.monotonic()
    totals: dict[str, Counter[str]] = {kind: Counter() for kind in given.kinds}
    failures = cases = 0
    rng = np.random.default_rng(given.seed)
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        seeds = {kind: seed(kind, root) for kind in given.kinds}
        while cases < given.cases:
            kind = given.kinds[cases // BATCH % len(given.kinds)]
            folder = root / "batch"
            folder.mkdir()
            make_batch(folder, seeds[kind], BATCH, rng)
            outcomes, broken = run_batch(folder, BATCH)
            totals[kind] += outcomes
            if broken:
                failures += 1
                print(f"{kind}: {broken}", file=sys.stderr)
                shutil.copytree(folder, given.keep / f"{kind}-{cases}", dirs_exist_ok=True)
            shutil.rmtree(folder)
            cases += BATCH
    for kind, outcomes in totals.items():
        print(f"{kind:<26}", ", ".join(f"{code} {count}" for code, count in outcomes.most_common()))
    print(f"{cases} cases in {time.monotonic() - began:.0f} s, {failures} batches broke the rule")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())

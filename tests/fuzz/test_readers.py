"""Mutated files against the readers, in a process of its own under a memory and a time limit.

Nothing may happen but a cloud or a FormatError: no signal, no hang, no other exception, no memory over the cap.
"""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pcdnf.formats import NpzFlavour, PlyFlavour, PointCloud, write

MUTANTS = 150
MEMORY_BYTES = 256 * 1024**2
SECONDS = 60

CHILD = """
import json, resource, sys
from pcdnf.formats import FormatError, Limits, read
cap = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize() + int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_AS, (cap, cap))
outcomes = {}
for index in range(int(sys.argv[3])):
    try:
        read(f"{sys.argv[1]}/{index}", limits=Limits(max_points=100_000, max_bytes=10**7))
        code = "read"
    except FormatError as error:
        code = error.code
    outcomes[code] = outcomes.get(code, 0) + 1
print(json.dumps(outcomes))
"""


def seed(kind: str, folder: Path) -> bytes:
    """A small valid file with attributes, comments and metadata."""
    rng = np.random.default_rng(0)
    cloud = PointCloud(
        points=rng.normal(size=(9, 3)),
        normals=rng.normal(size=(9, 3)),
        attributes={"red": np.arange(9, dtype=np.uint8), "tag": np.arange(9, dtype=np.int32)},
        comments=["a comment"],
        metadata={"device": "cpu"},
        flavour=NpzFlavour(compressed=kind == "deflated") if kind in ("stored", "deflated") else PlyFlavour(kind),
    )
    write(folder / "seed", cloud)
    return (folder / "seed").read_bytes()


def mutant(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes with a few changes: single values, cut or doubled spans, numbers blown up."""
    changed = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        at, stop = sorted(rng.integers(0, len(changed), 2).tolist())
        match int(rng.integers(6)):
            case 0:
                changed[at] = int(rng.integers(256))
            case 1:
                del changed[at : min(stop, at + 40)]
            case 2:
                changed[at:at] = changed[at : min(stop, at + 40)]
            case 3:
                changed[at : at + 4] = rng.choice([b"\xff" * 4, b"\0" * 4, b"\x7f\xff\xff\xff", b" nan", b"9999"])
            case 4:
                changed = bytearray(bytes(changed).replace(b"9", rng.choice([b"-9", b"9e9", b"99999999"]), 1))
            case _:
                changed[at] ^= 1 << int(rng.integers(8))
    return bytes(changed)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian", "stored", "deflated"])
def test_mutated_files_are_read_or_refused(tmp_path: Path, kind: str) -> None:
    data = seed(kind, tmp_path)
    rng = np.random.default_rng(len(kind))
    for index in range(MUTANTS):
        (tmp_path / str(index)).write_bytes(mutant(data, rng))
    command = [sys.executable, "-c", CHILD, str(tmp_path), str(MEMORY_BYTES), str(MUTANTS)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS)
    assert done.returncode == 0, done.stderr[-2000:]
    outcomes = json.load(io.StringIO(done.stdout))
    assert sum(outcomes.values()) == MUTANTS
    assert len(outcomes) >= 4, "the mutants reach different checks"

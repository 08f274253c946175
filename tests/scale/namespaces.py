"""The service as on five machines: network namespaces joined by a bridge. Needs root and Linux; started by hand.

    python -m tests.scale.namespaces [--points 200000] [--iterations 2]

PostgreSQL, S3 (SeaweedFS), an API process and two workers run in a namespace each, with an address each, so that they
meet over the network alone; each has a data folder of its own. The same cloud is denoised by one worker alone, by two,
and by two of which one loses its network in the middle.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx

from tests.support.service_process import write_sphere

BRIDGE, NETWORK = "pcdnf0", "10.97.53"
HOSTS = {"database": 2, "storage": 3, "api": 4, "worker-1": 5, "worker-2": 6}


def ip(*arguments: str) -> None:
    """Run ip(8)."""
    subprocess.run(["ip", *arguments], check=True)


def address(host: str) -> str:
    """Return the address of a host."""
    return f"{NETWORK}.{HOSTS[host]}"


@contextmanager
def network() -> Iterator[None]:
    """Make the bridge and a namespace for each host, and remove them."""
    try:
        ip("link", "add", BRIDGE, "type", "bridge")
        ip("address", "add", f"{NETWORK}.1/24", "dev", BRIDGE)
        ip("link", "set", BRIDGE, "up")
        for host, number in HOSTS.items():
            ip("netns", "add", f"pcdnf-{host}")
            ip("link", "add", f"pcdnf-h{number}", "type", "veth", "peer", "name", f"pcdnf-n{number}")
            ip("link", "set", f"pcdnf-n{number}", "netns", f"pcdnf-{host}")
            ip("link", "set", f"pcdnf-h{number}", "master", BRIDGE)
            ip("link", "set", f"pcdnf-h{number}", "up")
            inside = ("-n", f"pcdnf-{host}")
            ip(*inside, "address", "add", f"{address(host)}/24", "dev", f"pcdnf-n{number}")
            ip(*inside, "link", "set", f"pcdnf-n{number}", "up")
            ip(*inside, "link", "set", "lo", "up")
        yield
    finally:
        for host in HOSTS:
            subprocess.run(["ip", "netns", "delete", f"pcdnf-{host}"], check=False, stderr=subprocess.DEVNULL)
        subprocess.run(["ip", "link", "delete", BRIDGE], check=False)


class Hosts:
    """Processes on the hosts."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder, self.stack = folder, stack
        self.environment = dict(os.environ) | {"PYTHONPATH": str(Path(__file__).parents[2])}

    def start(self, host: str, *command: str, **environment: str) -> subprocess.Popen[str]:
        """Start a process on a host; it is killed at the end."""
        with (self.folder / f"{host}.log").open("ab") as log:
            process = subprocess.Popen(
                ["ip", "netns", "exec", f"pcdnf-{host}", sys.executable, *command],
                env=self.environment | environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE if command[0].endswith("servers.py") else log,
                stderr=log,
                text=True,
            )

        def end() -> None:
            assert process.stdin is not None
            process.stdin.close()  # what servers.py waits for
            if not command[0].endswith("servers.py"):
                process.kill()
            process.wait()

        self.stack.callback(end)
        return process

    def server(self, host: str, *arguments: str) -> object:
        """Start a server of tests/servers.py and return what it tells."""
        process = self.start(host, str(Path(__file__).parents[1] / "support" / "servers.py"), *arguments)
        assert process.stdout is not None
        return json.loads(process.stdout.readline())

    def worker(self, host: str) -> None:
        """Start a worker and wait until it is ready."""
        self.start(
            host,
            "-m",
            "service.worker",
            PCDNF_DATA_DIR=str(self.folder / host),
            PCDNF_WORKER_ID=host,
            PCDNF_THREADS="1",
        )
        self.wait(host, f"worker {host} ready")

    def wait(self, host: str, line: str) -> None:
        """Wait for a line in a log."""
        deadline = time.monotonic() + 120
        while line not in self.log(host):
            assert time.monotonic() < deadline, self.log(host)
            time.sleep(0.1)

    def log(self, host: str) -> str:
        """Return what a host has logged."""
        return (self.folder / f"{host}.log").read_text()

    def tiles(self, host: str, job: str) -> int:
        """Return how many tiles of a job a worker has finished."""
        return sum(f"job {job} iteration" in line and " tile " in line for line in self.log(host).splitlines())


def run(hosts: Hosts, client: httpx.Client, cloud: Path, iterations: int, *, cut_off: str | None = None) -> bytes:
    """Denoise a cloud, print what it took, and return the result."""
    began = time.monotonic()
    job = client.post("/denoise", files={"file": cloud.read_bytes()}, params={"iterations": iterations}).json()
    while (now := client.get(f"/jobs/{job['id']}").json())["status"] in ("queued", "running"):
        if cut_off is not None and hosts.tiles(cut_off, job["id"]) > 1:
            ip("link", "set", f"pcdnf-h{HOSTS[cut_off]}", "down")
            print(f"{cut_off} has no network from {time.monotonic() - began:.1f} s on")
            cut_off = None
        time.sleep(0.2)
    assert now["status"] == "succeeded", now
    tiles = {host: hosts.tiles(host, job["id"]) for host in ("worker-1", "worker-2") if (hosts.folder / host).exists()}
    print(f"{time.monotonic() - began:.1f} s; tiles by worker: {tiles}", flush=True)
    return client.get(f"/jobs/{job['id']}/result").content


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=200_000)
    parser.add_argument("--iterations", type=int, default=2)
    arguments = parser.parse_args()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="pcdnf-scale-")))
        folder.chmod(0o755)
        stack.enter_context(network())
        hosts = Hosts(folder, stack)
        hosts.environment["PCDNF_DATABASE_URL"] = str(hosts.server("database", "postgresql", address("database")))
        variables = hosts.server("storage", "s3", address("storage"), str(folder / "s3"))
        assert isinstance(variables, dict)
        hosts.environment |= variables | {
            "PCDNF_STORAGE_URL": "s3://tests/namespaces",
            "PCDNF_TILE_POINTS": "4096",
            "PCDNF_WORKER_STALE_SECONDS": "10",
        }
        cloud = write_sphere(folder / "cloud.ply", arguments.points)
        data = str(folder / "api")
        hosts.start(
            "api", "-m", "service.api",
            PCDNF_DATA_DIR=data, PCDNF_HOST="0.0.0.0", PCDNF_PORT="8000", PCDNF_ALLOW_ANONYMOUS="true",
        )  # fmt: skip
        client = stack.enter_context(
            httpx.Client(base_url=f"http://{address('api')}:8000", trust_env=False, timeout=60)
        )
        hosts.wait("api", "Application startup complete")
        hosts.worker("worker-1")
        print("one worker:")
        alone = run(hosts, client, cloud, arguments.iterations)
        hosts.worker("worker-2")
        print("two workers:")
        assert run(hosts, client, cloud, arguments.iterations) == alone
        print("two workers, one of which loses its network:")
        assert run(hosts, client, cloud, arguments.iterations, cut_off="worker-2") == alone
        print(f"three equal results of {len(alone)} bytes")


if __name__ == "__main__":
    main()

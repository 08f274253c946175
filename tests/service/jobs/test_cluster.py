"""Two workers, processes of their own, on PostgreSQL and S3: a large cloud shared, one of them killed or frozen."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from tests.support.cluster import Cluster
from tests.support.servers import postgresql
from tests.support.service_process import write_sphere

pytestmark = pytest.mark.full
POINTS, ITERATIONS = 5000, 2  # 20 tiles, 5 shards an iteration


@pytest.fixture(scope="module")
def shared_by_all(s3: dict[str, str]) -> Iterator[dict[str, str]]:
    """Database and storage of a cluster."""
    with postgresql() as url:
        yield s3 | {"PCDNF_DATABASE_URL": url, "PCDNF_STORAGE_URL": "s3://tests/cluster"}


@pytest.fixture(scope="module")
def cluster(shared_by_all: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """An API process and two workers."""
    with Cluster(tmp_path_factory.mktemp("cluster"), shared_by_all) as cluster:
        cluster.worker("first")
        cluster.worker("second")
        yield cluster


@pytest.fixture(scope="module")
def api(cluster: Cluster) -> httpx.Client:
    """A client of one of the API processes."""
    return cluster.api()


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cloud large enough to be shared."""
    return write_sphere(tmp_path_factory.mktemp("clouds") / "large.ply", POINTS)


@pytest.fixture(scope="module")
def alone(cloud: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The result that a worker makes alone, on SQLite and a folder."""
    with Cluster(tmp_path_factory.mktemp("alone"), {}) as single:
        # One folder, as `pcdnf serve` has it.
        single.environment["PCDNF_STORAGE_URL"] = (single.folder / "files").as_uri()
        single.environment["PCDNF_DATABASE_URL"] = f"sqlite:///{single.folder / 'jobs.sqlite'}"
        client = single.api()
        single.worker("alone")
        job = single.submit(client, cloud, iterations=ITERATIONS)
        assert single.ended(client, job)["status"] == "succeeded"
        assert "shares" not in single.log("alone")
        return client.get(f"/jobs/{job}/result").content


def _workers(cluster: Cluster, job: str) -> dict[str, int]:
    return {name: cluster.tiles(name, job) for name in ("first", "second")}


def test_a_large_cloud_is_shared_and_the_result_is_the_same(
    cluster: Cluster, api: httpx.Client, cloud: Path, alone: bytes
) -> None:
    job = cluster.submit(api, cloud, iterations=ITERATIONS)
    told = cluster.ended(api, job)
    assert told["status"] == "succeeded", told["problem"]
    assert told["progress"]["done"] == told["progress"]["total"] == POINTS * ITERATIONS
    shard = _workers(cluster, job)
    assert sum(shard.values()) == ITERATIONS * 20
    assert min(shard.values()) >= 4  # nobody looked on
    assert api.get(f"/jobs/{job}/result").content == alone


def test_another_api_process_gives_it_in_ranges(cluster: Cluster, api: httpx.Client, cloud: Path, alone: bytes) -> None:
    job = cluster.submit(api, cloud, iterations=ITERATIONS)
    assert cluster.ended(api, job)["status"] == "succeeded"
    other = cluster.api("other")
    part = other.get(f"/jobs/{job}/result", headers={"Range": "bytes=1000-4999"})
    assert (part.status_code, part.content) == (206, alone[1000:5000])
    assert part.headers["content-range"] == f"bytes 1000-4999/{len(alone)}"
    assert other.get(f"/jobs/{job}/result", params={"format": "pcd"}).status_code == 200
    assert other.get(f"/jobs/{job}/display").status_code == 200
    assert other.delete(f"/jobs/{job}").status_code == 204
    assert api.get(f"/jobs/{job}").status_code == 404
    assert cluster.stop("other") == 0


def test_cancelling_stops_every_share(cluster: Cluster, api: httpx.Client, tmp_path: Path) -> None:
    job = cluster.submit(api, write_sphere(tmp_path / "a.ply", 20_000), iterations=4)
    cluster.until(lambda: min(_workers(cluster, job).values()) > 0, "both at work")
    assert api.delete(f"/jobs/{job}").status_code == 202
    assert cluster.ended(api, job, 20)["status"] == "cancelled"
    done = _workers(cluster, job)
    next_one = cluster.submit(api, write_sphere(tmp_path / "b.ply", 300), iterations=1)
    assert cluster.ended(api, next_one, 20)["status"] == "succeeded"
    assert sum(_workers(cluster, job).values()) <= sum(done.values()) + 4  # what the two had in hand, of 316


@pytest.mark.parametrize("victim", ["parent", "helper"])
def test_a_worker_killed_in_the_middle(
    cluster: Cluster, api: httpx.Client, cloud: Path, alone: bytes, victim: str
) -> None:
    job = cluster.submit(api, cloud, iterations=ITERATIONS)
    cluster.until(lambda: min(_workers(cluster, job).values()) > 0, "both at work")
    parent = next(name for name in ("first", "second") if f"job {job} iteration 0 in 5 shares" in cluster.log(name))
    name = parent if victim == "parent" else {"first": "second", "second": "first"}[parent]
    cluster.kill(name)
    told = cluster.ended(api, job)
    assert told["status"] == "succeeded", told["problem"]
    assert api.get(f"/jobs/{job}/result").content == alone
    cluster.worker(name)


def test_a_frozen_worker_that_comes_back_changes_nothing(
    cluster: Cluster, api: httpx.Client, cloud: Path, alone: bytes
) -> None:
    job = cluster.submit(api, cloud, iterations=ITERATIONS)
    cluster.until(lambda: min(_workers(cluster, job).values()) > 0, "both at work")
    cluster.signal("second", signal.SIGSTOP)
    told = cluster.ended(api, job)
    cluster.signal("second", signal.SIGCONT)
    assert told["status"] == "succeeded", told["problem"]
    again = cluster.submit(api, cloud, iterations=ITERATIONS)
    assert cluster.ended(api, again)["status"] == "succeeded"
    assert min(_workers(cluster, again).values()) > 0  # it works again
    for each in (job, again):
        assert api.get(f"/jobs/{each}/result").content == alone
    assert api.get(f"/jobs/{job}").json()["progress"]["done"] == POINTS * ITERATIONS


def test_workers_stop_in_good_order(cluster: Cluster, api: httpx.Client, cloud: Path, alone: bytes) -> None:
    job = cluster.submit(api, cloud, iterations=ITERATIONS)
    cluster.until(lambda: min(_workers(cluster, job).values()) > 0, "both at work")
    assert cluster.stop("first") == 0
    assert cluster.ended(api, job)["status"] == "succeeded"
    assert api.get(f"/jobs/{job}/result").content == alone
    assert cluster.stop("second") == 0


def test_a_shared_folder_does_as_well_as_a_bucket(cloud: Path, alone: bytes, tmp_path: Path) -> None:
    folder = tmp_path / "shared"
    folder.mkdir()
    with (
        postgresql() as url,
        Cluster(tmp_path, {"PCDNF_DATABASE_URL": url, "PCDNF_STORAGE_URL": folder.as_uri()}) as cluster,
    ):
        cluster.worker("first")
        cluster.worker("second")
        api = cluster.api()
        job = cluster.submit(api, cloud, iterations=ITERATIONS)
        told = cluster.ended(api, job)
        assert told["status"] == "succeeded", told["problem"]
        shard = _workers(cluster, job)
        assert sum(shard.values()) == ITERATIONS * 20
        assert min(shard.values()) >= 4
        assert api.get(f"/jobs/{job}/result").content == alone
        assert api.delete(f"/jobs/{job}").status_code in (200, 204)
        assert [path for path in folder.rglob("*") if path.is_file()] == []
        assert cluster.refused("twin", as_worker="first") == (
            "pcdnf: A worker named first is running on another machine. "
            "Set PCDNF_WORKER_ID to another name for this one."
        )

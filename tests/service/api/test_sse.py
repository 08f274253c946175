from __future__ import annotations

import hashlib
import json
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.api import sse as events
from service.jobs.attempts import Attempts
from service.settings import Settings
from service.worker.model_cache import ModelCache
from tests.support.board import MakeApi
from tests.support.service_process import Served, Service, write_sphere

Event = dict[str, str]


def _events(response: httpx.Response) -> Iterator[Event]:
    """Yield the fields of each event, as a browser reads them; a comment is named ``""``."""
    event: Event = {}
    for line in response.iter_lines():
        if line:
            name, _, value = line.partition(":")
            event[name] = value.removeprefix(" ")
        elif event:
            yield event
            event = {}


def _submit(api: httpx.Client, path: Path) -> str:
    return str(api.post("/denoise", files={"file": path.read_bytes()}).json()["id"])


def test_a_job_from_its_start_to_its_end(running: Service, tmp_path: Path) -> None:
    job = running.submit(write_sphere(tmp_path / "a.ply", 5000))
    assert job["links"]["events"] == f"/jobs/{job['id']}/events"
    with running.client.stream("GET", job["links"]["events"]) as response:
        assert response.status_code == 200
        assert response.headers["content-type"].startswith("text/event-stream")
        assert response.headers["cache-control"] == "no-store"
        retry, *told = list(_events(response))  # until the service ends it
    assert int(retry["retry"]) > 0
    assert {event["event"] for event in told} == {"job"}
    shown = [json.loads(event["data"]) for event in told]
    done = [job["progress"]["done"] for job in shown]
    assert done == sorted(done)
    assert shown[-1] == running.job(job["id"])
    assert shown[-1]["status"] == "succeeded"
    assert len({event["id"] for event in told}) == len(told) >= 3
    link = f"/jobs/{job['id']}/events"
    with running.client.stream("GET", link, headers={"Last-Event-ID": told[0]["id"]}) as response:
        _, last = _events(response)  # what came between is made up for by the last
        assert last == told[-1]
    assert running.client.get(link, headers={"Last-Event-ID": last["id"]}).status_code == 204


def test_coming_back_with_the_last_id(make_api: MakeApi, small: Path) -> None:
    api = make_api()
    job = _submit(api, small)
    with api.stream("GET", f"/jobs/{job}/events") as response:
        told = _events(response)
        next(told)
        first = next(told)
        assert json.loads(first["data"])["queue_position"] == 1
    with api.stream("GET", f"/jobs/{job}/events", headers={"Last-Event-ID": first["id"]}) as response:
        told = _events(response)
        next(told)
        api.delete(f"/jobs/{job}")
        last = next(told)  # not the first again
        assert json.loads(last["data"])["status"] == "cancelled"
        assert list(told) == []


def test_the_plan_and_the_true_total_are_told_before_the_first_tile(
    make_served: Callable[..., Served], small: Path
) -> None:
    served = make_served()
    job = _submit(served.client, small)
    attempts = Attempts(served.app.state.engine, 1000)
    runs = ModelCache(Settings(device="cpu")).execution("pcdnf-lite")
    with served.client.stream("GET", f"/jobs/{job}/events") as response:
        told = _events(response)
        next(told), next(told)
        attempts.acquire(job)
        attempts.update(job, execution=runs)
        assert json.loads(next(told)["data"])["status"] == "running"
        plan = {"noise": 0.1, "spacing": 0.1, "radii": [0.1, 0.1, 0.1]}
        attempts.update(job, execution=runs | {"plan": plan}, total=6000)
        shown = json.loads(next(told)["data"])
        assert (shown["progress"]["done"], shown["progress"]["total"]) == (0, 6000)
        assert shown["execution"]["plan"]["radii"] == plan["radii"]


def test_heartbeats(make_api: MakeApi, small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events, "HEARTBEAT_SECONDS", 0.1)
    api = make_api()
    with api.stream("GET", f"/jobs/{_submit(api, small)}/events") as response:
        told = _events(response)
        assert [list(next(told)) for _ in range(4)] == [["retry"], ["event", "data", "id"], [""], [""]]


def test_no_more_streams_than_allowed(make_api: MakeApi, small: Path) -> None:
    api = make_api(max_streams=2)
    link = f"/jobs/{_submit(api, small)}/events"
    with api.stream("GET", link), api.stream("GET", link):
        refused = api.get(link)
        assert (refused.status_code, refused.json()["code"], refused.json()["limit"]) == (503, "too_busy", 2)
        assert refused.headers["retry-after"]
    for _ in range(20):  # a stream that its reader left is closed, and makes room
        with api.stream("GET", link) as response:
            if response.status_code == 200:
                break
        time.sleep(0.1)
    else:
        pytest.fail("the streams that were left stayed open")


def test_streams_are_the_callers_own(make_api: MakeApi, small: Path, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    keys.write_text("".join(f"{name}:{hashlib.sha256(name.encode()).hexdigest()}\n" for name in ("ada", "bob")))
    api = make_api(api_keys_file=keys)
    assert api.get(f"/jobs/{'0' * 32}/events").status_code == 401
    api.headers["Authorization"] = "Bearer ada"
    job = _submit(api, small)
    api.headers["Authorization"] = "Bearer bob"
    refused = api.get(f"/jobs/{job}/events")
    assert (refused.status_code, refused.json()["code"]) == (404, "job_not_found")


def test_streams_end_when_the_service_stops(make_served: Callable[..., Served], small: Path) -> None:
    served: Any = make_served()
    with served.client.stream("GET", f"/jobs/{_submit(served.client, small)}/events") as response:
        told = _events(response)
        next(told)
        served.app.state.watch.close()
        assert len(list(told)) == 1


def test_a_stream_does_not_hold_up_the_stop(tmp_path: Path, small: Path) -> None:
    service = Service(tmp_path / "service", poll_seconds=60).start(ready=False)
    with service.client.stream("GET", f"/jobs/{_submit(service.client, small)}/events") as response:
        told = _events(response)
        next(told)
        api = service.child("service.api")
        began = time.monotonic()
        os.kill(api, signal.SIGTERM)
        list(told)
        assert time.monotonic() - began < 5
    assert service.stop() == 0, service.output()

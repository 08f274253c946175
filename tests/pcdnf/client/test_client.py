"""The client, against a real service and a proxy that misbehaves."""

from __future__ import annotations

import re
import shutil
import socket
import ssl
import subprocess
import sys
import threading
import time
from datetime import UTC, datetime, timedelta
from email.utils import format_datetime
from http.server import HTTPServer
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel

from pcdnf.client import (
    Client,
    Execution,
    Job,
    JobError,
    Model,
    Plan,
    ProblemDetail,
    ProblemError,
    Progress,
    UnreachableError,
)
from pcdnf.errors import PcdnfError
from pcdnf.formats import read
from service.api import schemas
from tests.support.misbehaving import Handler, Proxy, alter, busy, cut_answer, drop, drop_answer
from tests.support.service_process import KEY, Service, write_sphere

LONG = {"iterations": 4}


def posts(proxy: Proxy) -> list[tuple[str, bytes]]:
    """Keys and bodies of the submissions that came by."""
    return [(seen.headers["idempotency-key"], seen.body) for seen in proxy.seen if seen.method == "POST"]


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (Job, schemas.JobView),
        (Progress, schemas.ProgressView),
        (Execution, schemas.ExecutionView),
        (Plan, schemas.PlanView),
        (ProblemDetail, schemas.ProblemDetail),
    ],
)
def test_models_are_those_of_the_service(ours: type[BaseModel], theirs: type[BaseModel]) -> None:
    assert ours.model_fields.keys() == theirs.model_fields.keys()
    assert Model.model_fields.keys() <= schemas.Model.model_fields.keys()


def test_a_file_goes_there_and_back(url: str, cloud: Path, tmp_path: Path) -> None:
    sent: list[tuple[int, int]] = []
    looks: list[Job] = []
    with Client(url) as client:
        job = client.submit(cloud, {"iterations": 2, "seed": "7"}, progress=lambda *bytes_: sent.append(bytes_))
        assert job.status in ("queued", "running")
        assert job.upload["name"] == "small scan"
        job = client.wait(job.id, progress=looks.append)
        assert job.status == "succeeded"
        assert (job.parameters["seed"], job.progress.done) == (7, 3000)
        assert job.execution is not None
        assert job.finished_at is not None
        assert job.finished_at.tzinfo is not None
        client.result(job.id, tmp_path / "out.ply")
        client.result(job.id, tmp_path / "out.npz", format="npz")
    size = cloud.stat().st_size
    assert sent[-1] == (size, size)
    assert [look.progress.done for look in looks] == sorted(look.progress.done for look in looks)
    after = read(tmp_path / "out.ply")
    np.testing.assert_array_equal(after.points, read(tmp_path / "out.npz").points)
    assert np.abs(np.linalg.norm(after.points, axis=1) - 1).mean() < 0.008
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.npz", "out.ply", cloud.name]


def test_denoise_does_all_of_it(url: str, cloud: Path, tmp_path: Path) -> None:
    with Client(url) as client:
        job = client.denoise(cloud, tmp_path / "out.npz", iterations=1)
    assert job.progress.total == 1500
    assert read(tmp_path / "out.npz").normals is not None


def test_a_problem_comes_with_its_words(url: str, cloud: Path, proxy: Proxy) -> None:
    with Client(proxy.address) as client, pytest.raises(ProblemError) as raised:
        client.submit(cloud, {"iterations": 99})
    error = raised.value
    assert (error.code, error.status, error.problem.limit) == ("invalid_parameters", 422, 4)
    assert "99 passes" in str(error)
    assert len(proxy.seen) == 1, "nothing to be gained by trying again"
    with Client(url) as client:
        with pytest.raises(ProblemError, match="no job with this id") as raised:
            client.job("0" * 32)
        assert raised.value.code == "job_not_found"
        with pytest.raises(PcdnfError, match="not a valid job id"):
            client.job("../models")


def test_what_is_no_problem_of_the_service_is_said_so(proxy: Proxy) -> None:
    proxy.faults = [lambda handler, _: handler.reply(403, {"Content-Type": "text/html"}, b"<h1>No</h1>")]
    with Client(proxy.address) as client, pytest.raises(ProblemError, match="403 Forbidden and did not") as raised:
        client.models()
    assert raised.value.code == "http_403"


def test_busy_is_waited_out_as_long_as_the_service_asks(proxy: Proxy, cloud: Path) -> None:
    in_two_seconds = format_datetime(datetime.now(UTC) + timedelta(seconds=2), usegmt=True)
    proxy.faults = [busy(429, "1"), busy(503, in_two_seconds)]
    pauses: list[float] = []
    began = time.monotonic()
    with Client(proxy.address, on_retry=lambda _, pause: pauses.append(pause)) as client:
        job = client.submit(cloud, {"iterations": 1})
        assert time.monotonic() - began >= 1.5
        assert pauses[0] == 1
        assert 0.5 <= pauses[1] <= 2
        assert client.wait(job.id).status == "succeeded"
    assert len(posts(proxy)) == 3
    assert len(set(posts(proxy))) == 1, "the same key and the same bytes every time"


@pytest.mark.parametrize("fault", [drop, drop_answer])
def test_a_lost_connection_makes_no_second_job(proxy: Proxy, cloud: Path, fault: object) -> None:
    with Client(proxy.address) as client:
        before = {job.id for job in client.jobs()}
        proxy.faults = [fault]  # type: ignore[list-item]
        job = client.submit(cloud, {"iterations": 1})
        assert {found.id for found in client.jobs()} - before == {job.id}
        client.wait(job.id)
    assert len(set(posts(proxy))) == 1
    assert len(posts(proxy)) == 2


def test_patience_ends(proxy: Proxy) -> None:
    proxy.faults = [busy(503, "60")] * 2
    began = time.monotonic()
    with Client(proxy.address, patience=20) as client, pytest.raises(ProblemError) as raised:
        client.models()
    assert raised.value.retry_after == 60
    assert time.monotonic() - began < 5, "it does not wait for what it will not live to see"
    assert len(proxy.seen) == 1


def test_a_wrong_address_is_given_up_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcdnf.client.retries.FIRST_CONTACT_SECONDS", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    began = time.monotonic()
    with Client(f"http://someone:secret@127.0.0.1:{port}/x") as client, pytest.raises(UnreachableError) as raised:
        client.models()
    assert time.monotonic() - began < 3
    assert f"http://127.0.0.1:{port}/x" in str(raised.value)
    assert "secret" not in str(raised.value)


@pytest.mark.parametrize("address", ["ftp://host", "host", "http://", "http://[", "http://host:99999999"])
def test_what_is_no_address(address: str) -> None:
    with pytest.raises(PcdnfError, match="not an http or https URL"):
        Client(address)


def test_a_broken_download_goes_on_where_it_stopped(proxy: Proxy, cloud: Path, tmp_path: Path) -> None:
    with Client(proxy.address) as client:
        job = client.wait(client.submit(cloud, {"iterations": 1}).id)
        client.result(job.id, tmp_path / "whole.ply")
        proxy.faults = [cut_answer]
        client.result(job.id, tmp_path / "pieces.ply")
    size = (tmp_path / "whole.ply").stat().st_size
    assert (tmp_path / "pieces.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
    assert proxy.seen[-1].headers["range"] == f"bytes={size // 2}-"


def test_an_altered_download_is_refused_and_leaves_nothing(proxy: Proxy, cloud: Path, tmp_path: Path) -> None:
    target = tmp_path / "out.ply"
    target.write_text("of before")
    with Client(proxy.address) as client:
        job = client.wait(client.submit(cloud, {"iterations": 1}).id)
        proxy.faults = [alter]
        with pytest.raises(PcdnfError, match="SHA-256"):
            client.result(job.id, target)
        with pytest.raises(PcdnfError, match="cannot be written: No such file"):
            client.result(job.id, tmp_path / "no" / "out.ply")
    assert target.read_text() == "of before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.ply", cloud.name]


def test_cancelling(url: str, tmp_path: Path) -> None:
    with Client(url) as client:
        job = client.submit(write_sphere(tmp_path / "large.ply", 8000), LONG)
        with pytest.raises(TimeoutError, match="did not end within 0 seconds"):
            client.wait(job.id, timeout=0)
        with pytest.raises(JobError, match=r"is (queued|running)"):
            client.succeeded(job)
        assert client.cancel(job.id).status in ("cancelling", "cancelled")
        ended = client.wait(job.id)
        assert ended.status == "cancelled"
        with pytest.raises(JobError, match="was cancelled") as raised:
            client.succeeded(ended)
        assert raised.value.job_id == job.id
        assert client.remove(job.id) is None


def test_a_result_cannot_be_cancelled(url: str, cloud: Path) -> None:
    with Client(url) as client:
        job = client.wait(client.submit(cloud, {"iterations": 1}).id)
        with pytest.raises(ProblemError, match="already succeeded and cannot be cancelled") as raised:
            client.cancel(job.id)
        assert raised.value.code == "already_finished"
        assert client.job(job.id).status == "succeeded"
        assert client.remove(job.id) is None


def test_jobs_come_page_by_page(url: str, cloud: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcdnf.client.client.PAGE", 2)
    with Client(url) as client:
        made = [client.submit(cloud, {"iterations": 1}).id for _ in range(5)]
        assert [job.id for job in client.jobs(5)] == made[::-1]
        assert [job.id for job in client.jobs()][:5] == made[::-1]
        assert len(list(client.jobs(3))) == 3
        for job_id in made:
            client.wait(job_id)


def test_models(url: str) -> None:
    with Client(url) as client:
        models = client.models()
    assert [model.name for model in models if model.default] == ["pcdnf-lite"]
    assert all(re.fullmatch("[0-9a-f]{64}", model.sha256) for model in models)


def test_keys(keyed: Service, monkeypatch: pytest.MonkeyPatch, proxy: Proxy) -> None:
    address = str(keyed.client.base_url)
    with Client(address) as client, pytest.raises(ProblemError, match="requires an API key"):
        client.models()
    monkeypatch.setenv("PCDNF_API_KEY", KEY)
    with Client(address) as client:
        assert client.models()
        assert KEY not in repr(vars(client))
    with Client(address, key="another") as client, pytest.raises(ProblemError):
        client.models()
    with pytest.raises(PcdnfError) as raised:
        Client(proxy.address, key="open\nsesame")
    assert "sesame" not in str(raised.value)


def test_certificates_are_verified(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make a certificate with")
    key, certificate = tmp_path / "key", tmp_path / "certificate"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=127.0.0.1",
         "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", key, "-out", certificate],
        check=True, capture_output=True,
    )  # fmt: skip

    class Empty(Handler):
        def handle_any(self) -> None:
            self.reply(200, {}, b"[]")

        do_GET = handle_any

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    with HTTPServer(("127.0.0.1", 0), Empty) as server:
        server.socket = context.wrap_socket(server.socket, server_side=True)
        server.handle_error = lambda *_: None  # type: ignore[method-assign] # the client hangs up
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        address = f"https://127.0.0.1:{server.server_port}"
        try:
            with Client(address) as client, pytest.raises(PcdnfError, match=r"certificate .* cannot be verified"):
                client.models()
            monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
            with Client(address) as client:
                assert client.models() == []
        finally:
            server.shutdown()
            thread.join()


def test_a_large_file_takes_no_memory(tmp_path: Path) -> None:
    large = tmp_path / "large.ply"
    with large.open("wb") as file:
        file.truncate(400 << 20)
    code = (
        "import resource, sys\n"
        "from pcdnf.client import Client, ProblemError\n"
        "def peak(): return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10\n"
        "before, sent = peak(), []\n"
        "with Client(sys.argv[1], patience=0) as client:\n"
        "    try: client.submit(sys.argv[2], progress=lambda done, total: sent.append(done))\n"
        "    except ProblemError as error: print(error.code)\n"
        "print(sent[-1] >> 20, peak() - before)"
    )

    class Discard(Handler):
        def handle_any(self) -> None:
            left = int(self.headers["content-length"])
            while left:
                left -= len(self.rfile.read(min(left, 1 << 20)))
            busy(422, "0")(self, lambda: pytest.fail("nobody to ask"))

        do_POST = handle_any

    with HTTPServer(("127.0.0.1", 0), Discard) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        address = f"http://127.0.0.1:{server.server_port}"
        done = subprocess.run([sys.executable, "-c", code, address, large], capture_output=True, text=True, timeout=120)
        server.shutdown()
        thread.join()
    assert done.returncode == 0, done.stderr
    code_, sent, grown = done.stdout.split()
    assert code_ == "too_busy"
    assert int(sent) == 400
    assert int(grown) < 40, "MiB"


def test_without_httpx_it_says_what_to_install() -> None:
    code = "import sys; sys.modules['httpx'] = None\nfrom pcdnf.cli.main import main\nsys.exit(main(['jobs']))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert "pip install 'pcdnf[client]'" in done.stderr
    assert "Traceback" not in done.stderr

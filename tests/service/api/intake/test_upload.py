from __future__ import annotations

import errno
import gzip
import json
import socket
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.api.intake.upload import clean_name
from tests.support.board import MakeApi
from tests.support.service_process import Served

BOUNDARY = "xyz"
FORM = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}


def _part(name: str, content: bytes, file: str | None = None) -> bytes:
    disposition = f'form-data; name="{name}"' + (f'; filename="{file}"' if file is not None else "")
    return f"--{BOUNDARY}\r\nContent-Disposition: {disposition}\r\n\r\n".encode() + content + b"\r\n"


def _form(*parts: bytes) -> bytes:
    return b"".join(parts) + f"--{BOUNDARY}--\r\n".encode()


@pytest.mark.parametrize(
    ("given", "cleaned"),
    [
        ("scan.ply", "scan"),
        ("Scan 3 (left).PLY", "Scan 3 (left)"),
        ("../../etc/passwd", "passwd"),
        ("C:\\clouds\\a.npz", "a"),
        ("a\x00b\r\nSet-Cookie: x.ply", "a_b__Set-Cookie_ x"),
        ('a";b.ply', "a__b"),
        ("église.ply", "église"),
        ("..", "cloud"),
        ("", "cloud"),
        (None, "cloud"),
        (".ply", "cloud"),
        ("scan.ply.gz", "scan"),
        ("scan.ZIP", "scan"),
        ("n" * 4096, "n" * 100),
    ],
)
def test_names_are_cleaned(given: str | None, cleaned: str) -> None:
    assert clean_name(given) == cleaned


@pytest.mark.parametrize("content_type", ["application/ply", "application/x-npz", "application/octet-stream"])
def test_raw_body(api: httpx.Client, small: Path, content_type: str) -> None:
    response = api.post("/denoise", content=small.read_bytes(), headers={"Content-Type": content_type})
    assert response.status_code == 202
    assert response.json()["upload"] == {
        "name": "cloud", "format": "ply", "bytes": small.stat().st_size, "points": 2000, "has_normals": False,
    }  # fmt: skip


def test_form_with_parameters_on_both_sides_of_the_file(api: httpx.Client, small: Path) -> None:
    body = _form(_part("iterations", b"2"), _part("file", small.read_bytes(), "a.ply"), _part("seed", b"7"))
    response = api.post("/denoise?model=pcdnf-lite", content=body, headers=FORM)
    assert response.status_code == 202
    assert response.json()["parameters"] == {
        "iterations": 2, "radius": "auto", "model": "pcdnf-lite", "seed": 7, "normals": "auto", "orient": False,
        "outliers": "keep", "nonfinite": "keep", "fast": False, "ignore_classes": "", "coordinates": "keep",
        "diagnostics": False, "sensor": "",
    }  # fmt: skip
    assert response.json()["upload"]["name"] == "a"


def test_chunked_body_cut_anywhere(api: httpx.Client, small: Path) -> None:
    body = _form(_part("file", small.read_bytes(), "a.ply"))

    def pieces() -> Iterator[bytes]:
        yield from (body[at : at + 997] for at in range(0, len(body), 997))

    response = api.post("/denoise", content=pieces(), headers=FORM)
    assert (response.status_code, response.json()["upload"]["points"]) == (202, 2000)


@pytest.mark.parametrize(
    ("body", "limit"),
    [
        (_form(), 1),
        (_form(_part("cloud", b"x")), 1),
        (_form(_part("cloud", b"x", "a.ply")), None),
        (_form(*[_part("file", b"x", "a")] * 101), 100),
        (_form(_part("file", b"x", "a"), _part("seed", b"1" * 2000)), 1024),
        (_form(_part("file", b"x", "a"), *(_part(f"field{i}", b"") for i in range(20))), 16),
        (_part("file", b"x", "a"), None),
        (b"--other\r\n", None),
        (b"nothing of the kind", None),
    ],
)
def test_bad_forms(api: httpx.Client, body: bytes, limit: int | None) -> None:
    response = api.post("/denoise", content=body, headers=FORM)
    assert (response.status_code, response.json()["code"]) == (422, "invalid_upload")
    assert response.json().get("limit") == limit


def test_a_file_in_a_part_with_another_name_is_told_so(api: httpx.Client, small: Path) -> None:
    problem = api.post("/denoise", files={"cloud": ("a.ply", small.read_bytes())}).json()
    assert "the part named 'cloud'" in problem["detail"]
    assert "-F file=@scan.ply" in problem["hint"]


@pytest.mark.parametrize("by", ["query", "header", "curl"])
def test_a_raw_body_may_bring_its_name(api: httpx.Client, by: str) -> None:
    text = b"".join(b"%d %d %d\n" % (i, i * i, i % 7) for i in range(50))
    headers = {"Content-Type": "application/octet-stream"}
    if by == "header":
        headers["Content-Disposition"] = 'attachment; filename="../left scan.xyz"'
    if by == "curl":
        headers["Content-Type"] = "application/x-www-form-urlencoded"
    query = "" if by == "header" else "?filename=left%20scan.xyz"
    response = api.post(f"/denoise{query}", content=text, headers=headers)
    assert response.status_code == 202, response.text
    upload = response.json()["upload"]
    assert (upload["name"], upload["format"], upload["points"]) == ("left scan", "xyz", 50)


def test_the_limit_named_is_the_one_in_force(make_api: MakeApi, small: Path) -> None:
    api = make_api(max_caller_bytes=1000)
    for files in ({"file": small.read_bytes()}, {"file": bytes(1001)}):
        problem = api.post("/denoise", files=files).json()
        assert (problem["code"], problem["limit"]) == ("upload_too_large", 1000)


def test_a_radius_beyond_the_cloud_is_refused_with_a_sentence(api: httpx.Client, small: Path) -> None:
    problem = api.post("/denoise?radius=50", files={"file": small.read_bytes()}).json()
    assert problem["code"] == "invalid_parameters"
    assert problem["detail"].startswith("radius: 50 is more than 3.")
    assert "diagonal" in problem["detail"]
    assert "`radius`" in problem["hint"]
    assert api.post("/denoise?radius=100%25", files={"file": small.read_bytes()}).status_code == 202


def test_a_form_without_boundary(api: httpx.Client) -> None:
    response = api.post("/denoise", content=b"x", headers={"Content-Type": "multipart/form-data"})
    assert response.json()["code"] == "invalid_upload"


@pytest.mark.parametrize("headers", [FORM, {"Content-Type": "application/ply"}])
def test_empty(api: httpx.Client, headers: dict[str, str]) -> None:
    body = _form(_part("file", b"", "a.ply")) if headers is FORM else b""
    response = api.post("/denoise", content=body, headers=headers)
    assert (response.status_code, response.json()["code"]) == (422, "empty_upload")


@pytest.mark.parametrize(
    ("headers", "code"),
    [
        ({"Content-Type": "application/json"}, "unsupported_media_type"),
        ({}, "unsupported_media_type"),
        ({"Content-Type": "application/ply", "Content-Encoding": "zstd"}, "unsupported_encoding"),
    ],
)
def test_unsupported(api: httpx.Client, small: Path, headers: dict[str, str], code: str) -> None:
    response = api.post("/denoise", content=gzip.compress(small.read_bytes()), headers=headers)
    assert (response.status_code, response.json()["code"]) == (415, code)


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ("iteration=2", "iteration: there is no such parameter."),
        ("iterations=0", "iterations: Iterations must be auto or a whole number from 1 to 100, not '0'."),
        ("iterations=" + "1" * 5000, f"100, not '{'1' * 40}'."),
        ("iterations=x", "not 'x'"),
        ("radius=-1", "radius: The radius must be auto, a length in the cloud's unit, or a percentage"),
        ("radius=200%25", "not '200%'"),
        ("orient=maybe", "orient"),
        ("outliers=some", "'keep', 'drop' or 'mark'"),
        ("sensor=1,2", "sensor: The sensor must be three finite numbers with commas between them"),
        ("iterations=5", "allows 4"),
        ("seed=-1", "must be at least 0"),
        ("seed=4294967296", "less than"),
        ("model=../x", "model: there is no model named '../x'."),
        ("normals=none", "'auto', 'pca' or 'input'"),
        ("nonfinite=mend", "'keep', 'reject' or 'drop'"),
        ("ignore_classes=noise", "ignore_classes"),
        ("coordinates=float16", "'keep', 'float32' or 'float64'"),
        ("seed=1&seed=2", "given twice, with different values"),
    ],
)
def test_bad_parameters(api: httpx.Client, small: Path, query: str, words: str) -> None:
    response = api.post(f"/denoise?{query}", files={"file": small.read_bytes()})
    assert (response.status_code, response.json()["code"]) == (422, "invalid_parameters")
    assert words in response.json()["detail"]


def test_bad_parameters_in_the_form(api: httpx.Client, small: Path) -> None:
    for query, fields in (("", {"iterations": "9"}), ("", {"speed": "1"}), ("?seed=1", {"seed": "2"})):
        response = api.post(f"/denoise{query}", files={"file": small.read_bytes()}, data=fields)
        assert (response.status_code, response.json()["code"]) == (422, "invalid_parameters")


def test_the_same_value_twice_and_in_any_case_is_no_fault(api: httpx.Client, small: Path) -> None:
    query = "?seed=1&fast=FALSE&normals=Auto"
    fields = {"seed": "1", "outliers": "KEEP", "radius": "AUTO", "iterations": "Auto"}
    response = api.post(f"/denoise{query}", files={"file": small.read_bytes()}, data=fields)
    assert response.status_code == 202
    found = response.json()["parameters"]
    assert [found[name] for name in ("seed", "normals", "outliers", "radius", "iterations")] == [
        1, "auto", "keep", "auto", "auto",
    ]  # fmt: skip


def test_too_large_by_its_length_and_as_it_arrives(make_api: MakeApi, tmp_path: Path, small: Path) -> None:
    limit = small.stat().st_size
    api = make_api(max_upload_bytes=limit)
    headers = {"Content-Type": "application/ply"}
    assert api.post("/denoise", content=small.read_bytes(), headers=headers).status_code == 202
    assert api.post("/denoise", files={"file": small.read_bytes()}).status_code == 202
    over = small.read_bytes() + b"\0"
    for content in (over, iter([over[:1000], over[1000:]])):
        response = api.post("/denoise", content=content, headers=headers)
        assert (response.status_code, response.json()["code"]) == (413, "upload_too_large")
        assert (response.json()["limit"], response.json()["actual"]) == (limit, limit + 1)
    assert api.post("/denoise", files={"file": over}).status_code == 413
    assert not list((tmp_path / "data" / "scratch").iterdir())


def _raw(served: Served, head: str, *pieces: tuple[bytes, float]) -> tuple[int, dict[str, Any], float]:
    """Send a request piece by piece; return status, body and the seconds until the answer."""
    with socket.create_connection(served.address, timeout=20) as connection:
        connection.sendall(f"POST /denoise HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{head}\r\n\r\n".encode())
        began = time.monotonic()
        for piece, pause in pieces:
            connection.sendall(piece)
            time.sleep(pause)
        answer = b""
        while piece := connection.recv(65536):
            answer += piece
        status, _, body = answer.partition(b"\r\n\r\n")
        return int(status.split()[1]), json.loads(body), time.monotonic() - began


def test_early_refusal_by_a_content_length(make_served: Callable[..., Served]) -> None:
    served = make_served(max_upload_bytes=1000)
    status, body, _ = _raw(served, "Content-Type: application/ply\r\nContent-Length: 99999999999")
    assert (status, body["code"], body["actual"]) == (413, "upload_too_large", 99999999999)


def test_deadline(make_served: Callable[..., Served], tmp_path: Path) -> None:
    served = make_served(upload_deadline=0.5)
    status, body, seconds = _raw(served, "Content-Type: application/ply\r\nContent-Length: 1000", (b"ply\n", 0.0))
    assert (status, body["code"]) == (408, "upload_too_slow")
    assert 0.4 < seconds < 5
    assert not list((tmp_path / "data" / "scratch").iterdir())


def test_minimum_rate(make_served: Callable[..., Served], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.api.intake.upload_pace.RATE_GRACE_SECONDS", 0.5)
    served = make_served(upload_min_rate=1000)
    status, body, seconds = _raw(
        served, "Content-Type: application/ply\r\nContent-Length: 10000", (b"x" * 500, 0.2), (b"x" * 100, 0.0)
    )
    assert (status, body["code"]) == (408, "upload_too_slow")
    assert 0.8 < seconds < 5


def test_a_caller_that_goes_away_leaves_nothing(make_served: Callable[..., Served], tmp_path: Path) -> None:
    served = make_served()
    with socket.create_connection(served.address) as connection:
        connection.sendall(
            b"POST /denoise HTTP/1.1\r\nHost: localhost\r\n"
            b"Content-Type: application/ply\r\nContent-Length: 1000\r\n\r\nply\n"
        )
        time.sleep(0.3)
    deadline = time.monotonic() + 5
    while list((tmp_path / "data" / "scratch").iterdir()) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not list((tmp_path / "data" / "scratch").iterdir())
    assert served.client.get("/jobs").json() == []


def test_no_disk_space(make_api: MakeApi, small: Path) -> None:
    response = make_api(min_free_bytes=10**18).post("/denoise", files={"file": small.read_bytes()})
    assert (response.status_code, response.json()["code"]) == (503, "disk_full")
    assert "retry-after" in response.headers


def test_disk_that_fills_up_meanwhile(
    make_api: MakeApi, small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("service.api.intake.sink.Sink._write", full)
    response = make_api().post("/denoise", files={"file": small.read_bytes()})
    assert (response.status_code, response.json()["code"]) == (503, "disk_full")
    assert not list((tmp_path / "data" / "scratch").iterdir())


def test_the_libraries_that_take_requests_apart_are_mended_ones() -> None:
    project = tomllib.loads((Path(__file__).parents[4] / "pyproject.toml").read_text())["project"]
    floors = dict(each.split(">=") for each in project["optional-dependencies"]["service"] if each.count(">=") == 1)
    for name, least in (("starlette", (1, 3, 1)), ("python-multipart", (0, 0, 31))):  # ranges, floods of parts
        assert tuple(map(int, floors[name].split(",")[0].split("."))) >= least

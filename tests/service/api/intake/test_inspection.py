from __future__ import annotations

import io
from pathlib import Path

import httpx
import numpy as np
import pytest

from pcdnf.denoiser import Denoiser
from pcdnf.formats import CODES
from service.api.intake.inspection import MINIMUM_POINTS, file_problem
from service.jobs.store import USUAL_ITERATIONS
from tests.support.board import MakeApi
from tests.support.service_process import sphere


def _npz(**arrays: object) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def _ply(count: int, points: np.ndarray) -> bytes:
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n"
    return (header + "property float x\nproperty float y\nproperty float z\nend_header\n").encode() + points.astype(
        "<f4"
    ).tobytes()


POINTS = sphere(100)
HOLED = np.where(np.arange(100)[:, None] == 7, np.nan, POINTS)


@pytest.mark.parametrize(
    ("content", "status", "code"),
    [
        (b"solid stl\n", 415, "unknown_format"),
        (b"ply\nformat binary_little_endian 1.0\n", 422, "bad_header"),
        (_ply(101, POINTS), 422, "truncated"),
        (_ply(99, POINTS), 422, "trailing_data"),
        (_ply(2**62, POINTS), 413, "too_many_points"),
        (_ply(10, POINTS[:10]), 422, "too_few_points"),
        (_ply(100, POINTS * 0), 422, "zero_extent"),
        (_npz(points=POINTS.T), 422, "bad_shape"),
        (_npz(points=np.array(["a", "b"])), 422, "unsupported_dtype"),
        (_npz(other=POINTS), 422, "missing_coordinates"),
    ],
)
def test_bad_files(api: httpx.Client, content: bytes, status: int, code: str) -> None:
    before = api.get("/jobs").json()
    response = api.post("/denoise", files={"file": ("a.ply", content)})
    assert (response.status_code, response.json()["code"]) == (status, code), response.text
    assert response.headers["content-type"] == "application/problem+json"
    assert response.json()["hint"]
    assert api.get("/jobs").json() == before


TEXT = "\n".join(" ".join(map(repr, row)) for row in POINTS.tolist()).encode()


@pytest.mark.parametrize(
    ("name", "content_type", "format_"),
    [
        ("a.xyz", "application/octet-stream", "xyz"),
        ("a.TXT", "application/octet-stream", "xyz"),
        ("a", "text/plain", "xyz"),
        ("a", "text/csv; charset=utf-8", "xyz"),
        ("a.ply", "application/octet-stream", None),
        ("a", "application/octet-stream", None),
    ],
)
def test_text_by_its_name_or_its_type(api: httpx.Client, name: str, content_type: str, format_: str | None) -> None:
    response = api.post("/denoise", files={"file": (name, TEXT, content_type)})
    if format_ is None:
        assert (response.status_code, response.json()["code"]) == (415, "unknown_format")
    else:
        assert response.status_code == 202, response.text
        upload = response.json()["upload"]
        assert (upload["format"], upload["points"], upload["name"]) == (format_, 100, "a")


def test_text_as_the_whole_body(api: httpx.Client) -> None:
    for content_type, data, format_ in (
        ("text/plain", TEXT, "xyz"),
        ("text/csv", TEXT.replace(b" ", b","), "csv"),
        ("text/plain", b"100\n" + TEXT, "pts"),
    ):
        response = api.post("/denoise", content=data, headers={"Content-Type": content_type})
        assert (response.status_code, response.json()["upload"]["format"]) == (202, format_)
    response = api.post("/denoise", content=b"no numbers", headers={"Content-Type": "text/plain"})
    assert (response.status_code, response.json()["code"]) == (422, "missing_coordinates")


def test_every_code_of_the_reader_has_a_client_error() -> None:
    for code in CODES:
        problem = file_problem({"code": code, "detail": "x", "hint": "y"})
        assert problem.status in ((503,) if code == "disk_full" else (413, 415, 422))
        assert problem.code == code


def test_dropping_bad_rows(api: httpx.Client) -> None:
    job = api.post("/denoise?nonfinite=drop", files={"file": _ply(100, HOLED)}).json()
    assert job["upload"]["points"] == 99
    assert job["progress"]["total"] == 99 * USUAL_ITERATIONS
    assert "7 (1 row)" in job["warnings"][0]


def test_normals_of_the_file(api: httpx.Client) -> None:
    without, with_normals = _npz(points=POINTS), _npz(points=POINTS, normals=POINTS)
    response = api.post("/denoise?normals=input", files={"file": without})
    assert (response.status_code, response.json()["code"]) == (422, "normals_missing")
    assert api.post("/denoise?normals=input", files={"file": with_normals}).status_code == 202


def test_limits_of_points_and_of_inflation(make_api: MakeApi) -> None:
    api = make_api(max_points=99, max_inflated_bytes=10_000)
    response = api.post("/denoise", files={"file": _ply(100, POINTS)})
    assert (response.status_code, response.json()["code"]) == (413, "too_many_points")
    assert (response.json()["limit"], response.json()["actual"]) == (99, 100)
    bomb = _npz(points=np.zeros((50, 3)), other=np.zeros(10_000))
    assert len(bomb) < 10_000
    response = api.post("/denoise", files={"file": bomb})
    assert response.status_code in (413, 422)


def test_time_limit(make_api: MakeApi, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.api.sandbox.WALL_FACTOR", 0.01)
    response = make_api(check_seconds=1).post("/denoise", files={"file": _ply(100, POINTS)})
    assert (response.status_code, response.json()["code"]) == (422, "took_too_long")
    assert not list((tmp_path / "data" / "scratch").iterdir())


def test_one_point_too_few(api: httpx.Client) -> None:
    for count, status in ((MINIMUM_POINTS - 1, 422), (MINIMUM_POINTS, 202), (MINIMUM_POINTS + 1, 202)):
        response = api.post("/denoise", files={"file": _ply(count, POINTS[:count])})
        assert response.status_code == status
        if status == 422:
            assert (response.json()["code"], response.json()["limit"]) == ("too_few_points", MINIMUM_POINTS)


def test_the_minimum_is_the_denoisers() -> None:
    assert Denoiser.load("pcdnf-lite", device="cpu").minimum_points == MINIMUM_POINTS

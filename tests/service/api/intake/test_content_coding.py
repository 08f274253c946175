"""Packed uploads: ``Content-Encoding: gzip``, files packed by gzip, zip archives; all of them counted unpacked."""

from __future__ import annotations

import gzip
import io
import zipfile
from pathlib import Path

import httpx
import pytest

from tests.support.board import MakeApi

RAW = {"Content-Type": "application/ply"}
CODED = RAW | {"Content-Encoding": "gzip"}


def zipped(name: str, content: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)
    return buffer.getvalue()


def test_a_coded_body(api: httpx.Client, small: Path) -> None:
    content = small.read_bytes()
    plain = api.post("/denoise", content=content, headers=RAW).json()
    assert api.post("/denoise", content=gzip.compress(content), headers=CODED).json()["upload"] == plain["upload"]
    form = httpx.Request("POST", "http://x/", files={"file": ("a.ply", content)})
    headers = {"Content-Type": form.headers["content-type"], "Content-Encoding": "GZIP"}
    coded = api.post("/denoise", content=gzip.compress(form.read()), headers=headers)
    assert (coded.status_code, coded.json()["upload"]["points"]) == (202, 2000)


@pytest.mark.parametrize("pack", ["gzip", "zip"])
def test_a_packed_file(api: httpx.Client, small: Path, pack: str) -> None:
    content = small.read_bytes()
    name, packed = (
        ("scan.ply.gz", gzip.compress(content)) if pack == "gzip" else ("scan.zip", zipped("left.ply", content))
    )
    response = api.post("/denoise", files={"file": (name, packed)})
    assert response.status_code == 202, response.text
    assert response.json()["upload"] == {
        "name": "scan", "format": "ply", "bytes": len(content), "points": 2000, "has_normals": False,
    }  # fmt: skip


def test_packed_text_is_known_by_its_name(api: httpx.Client) -> None:
    text = b"".join(b"%d %d %d\n" % (i, i * i, i % 7) for i in range(50))
    for name, packed in (("a.xyz.gz", gzip.compress(text)), ("a.zip", zipped("a.xyz", text))):
        response = api.post("/denoise", files={"file": (name, packed)})
        assert (response.status_code, response.json()["upload"]["format"]) == (202, "xyz"), response.text


def test_bombs_stop_at_the_limit(make_api: MakeApi, tmp_path: Path) -> None:
    api = make_api(max_upload_bytes=1_000_000)
    zeros = bytes(60_000_000)
    for content, headers in (
        (gzip.compress(zeros), CODED),
        (gzip.compress(zeros), RAW),
        (zipped("a.ply", zeros), RAW),
        (gzip.compress(gzip.compress(zeros)), CODED),
    ):
        assert len(content) < 100_000
        response = api.post("/denoise", content=content, headers=headers)
        assert response.status_code == 413, response.text
        assert response.json()["code"] in ("upload_too_large", "file_too_large")
        assert response.json()["limit"] == 1_000_000
    assert not list((tmp_path / "data" / "scratch").iterdir())


def test_bodies_that_are_not_what_their_coding_says(api: httpx.Client, small: Path) -> None:
    packed = gzip.compress(small.read_bytes())
    for content in (small.read_bytes(), packed[:-20], packed + b"x"):
        response = api.post("/denoise", content=content, headers=CODED)
        assert (response.status_code, response.json()["code"]) == (422, "invalid_upload")
        assert "Content-Encoding" in response.json()["detail"]
    response = api.post("/denoise", content=packed, headers=RAW | {"Content-Encoding": "br"})
    assert (response.status_code, response.json()["code"]) == (415, "unsupported_encoding")
    assert response.headers["accept-encoding"] == "gzip"

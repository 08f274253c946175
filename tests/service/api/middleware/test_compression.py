from __future__ import annotations

from pathlib import Path

import httpx
import pytest

from service.api.app import create_app
from service.settings import Settings
from tests.support.service_process import Served

GZIP = {"Accept-Encoding": "gzip"}


@pytest.mark.parametrize("path", ["/viewer/app.js", "/openapi.json", "/"])
def test_what_shrinks_is_compressed_for_those_who_accept_it(api: httpx.Client, path: str) -> None:
    plain, packed = api.get(path, headers={"Accept-Encoding": "identity"}), api.get(path, headers=GZIP)
    assert "content-encoding" not in plain.headers
    assert packed.headers["content-encoding"] == "gzip"
    assert "Accept-Encoding" in packed.headers["vary"]
    assert packed.content == plain.content
    assert packed.num_bytes_downloaded < 0.6 * plain.num_bytes_downloaded


@pytest.mark.parametrize("path", ["/livez", "/jobs", "/jobs/unknown"])
def test_short_answers_are_not(api: httpx.Client, path: str) -> None:
    assert "content-encoding" not in api.get(path, headers=GZIP).headers


def test_a_range_of_a_file_is_of_the_file(api: httpx.Client) -> None:
    part = api.get("/viewer/app.js", headers=GZIP | {"Range": "bytes=10-2009"})
    assert part.status_code == 206
    assert "content-encoding" not in part.headers
    assert part.content == api.get("/viewer/app.js").content[10:2010]


@pytest.mark.parametrize("media_type", ["text/plain", "application/ply", "model/gltf-binary", "text/event-stream"])
def test_clouds_and_streams_are_not(tmp_path: Path, media_type: str) -> None:
    from fastapi import Response

    app = create_app(Settings(data_dir=tmp_path))

    @app.get("/cloud")
    async def cloud() -> Response:
        return Response(b"1 2 3\n" * 5000, media_type=media_type)

    with Served(app) as client:
        assert "content-encoding" not in client.get("/cloud", headers=GZIP).headers

"""The API with its worker, over HTTP."""

from __future__ import annotations

import base64
import hashlib
import io
import struct
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

import pcdnf
from pcdnf.denoiser import Denoiser
from pcdnf.formats import NpzFlavour, PlyFlavour, PointCloud, read, write
from pcdnf.formats.flavours import Block
from pcdnf.geometry.normals import pca_normals
from service.jobs.store import USUAL_ITERATIONS
from tests.support.display_file import read_display
from tests.support.service_process import Service, sphere


def _read(response: httpx.Response, folder: Path) -> PointCloud:
    path = folder / "result"
    path.write_bytes(response.content)
    return read(path)


def test_accepted(running: Service, small: Path) -> None:
    response = running.client.post("/denoise", files={"file": ("x.ply", small.read_bytes())})
    job = response.json()
    assert response.status_code == 202
    assert response.headers["location"] == f"/jobs/{job['id']}"
    assert 1 <= int(response.headers["retry-after"]) <= 30
    assert len(job["id"]) == 32
    assert job["progress"] == {"done": 0, "total": 2000 * USUAL_ITERATIONS, "unit": "points"}
    assert job["status"] == "queued"
    assert job["queue_position"] >= 1
    running.wait_status(job["id"], "succeeded")


def test_finished_job(running: Service, done: dict[str, Any]) -> None:
    assert done["status"] == "succeeded", done["problem"]
    assert done["progress"] == {"done": 4000, "total": 4000, "unit": "points"}
    assert done["queue_position"] is done["seconds_left"] is done["problem"] is None
    assert done["points_per_second"] > 0
    times = [datetime.fromisoformat(done[f"{name}_at"]) for name in ("created", "started", "finished", "expires")]
    assert times == sorted(times)
    assert all(time.utcoffset() is not None for time in times)
    assert (times[3] - times[2]).total_seconds() == 24 * 3600
    own = f"/jobs/{done['id']}"
    assert done["links"] == {"self": own, "result": f"{own}/result", "display": f"{own}/display"}
    assert done["execution"]["model"] == "pcdnf-lite"
    assert done["execution"]["version"] == pcdnf.__version__
    assert done["execution"]["cpu_fallback"] == (done["execution"]["device"] == "cpu")
    assert "retry-after" not in running.client.get(f"/jobs/{done['id']}").headers


def test_etag(running: Service, done: dict[str, Any]) -> None:
    first = running.client.get(f"/jobs/{done['id']}")
    for known in (first.headers["etag"], f'"x", W/{first.headers["etag"]}', "*"):
        again = running.client.get(f"/jobs/{done['id']}", headers={"If-None-Match": known})
        assert (again.status_code, again.content) == (304, b"")
        assert again.headers["etag"] == first.headers["etag"]
    assert running.client.get(f"/jobs/{done['id']}", headers={"If-None-Match": '"x"'}).status_code == 200


def test_result_is_what_the_library_computes(
    running: Service, done: dict[str, Any], small: Path, tmp_path: Path
) -> None:
    result = _read(running.client.get(done["links"]["result"]), tmp_path)
    execution = done["execution"]
    denoiser = Denoiser.load("pcdnf-lite", device=execution["device"], precision=execution["precision"])
    expected = denoiser.denoise(read(small).points, iterations=2, seed=3)
    # Threads may sum in another order.
    np.testing.assert_allclose(result.points, expected.points, atol=1e-6)
    assert (np.einsum("ni,ni->n", result.normals, expected.normals) > 0.9999).mean() > 0.999
    assert result.metadata == expected.metadata | {"orient": "off", "outliers": "keep"}
    assert result.metadata["weights_sha256"] == execution["weights_sha256"] == denoiser.info.sha256
    before, after = (
        np.abs(np.linalg.norm(points, axis=1) - 1).mean() for points in (read(small).points, result.points)
    )
    assert after < before


def test_result_headers(running: Service, done: dict[str, Any]) -> None:
    response = running.client.get(done["links"]["result"])
    digest = "sha-256=:" + base64.b64encode(hashlib.sha256(response.content).digest()).decode() + ":"
    assert response.headers["content-type"] == "application/ply"
    assert response.headers["content-disposition"] == "attachment; filename*=utf-8''small%20scan_denoised.ply"
    assert response.headers["repr-digest"] == response.headers["content-digest"] == digest
    assert int(response.headers["content-length"]) == len(response.content)
    assert response.headers["x-content-type-options"] == "nosniff"
    head = running.client.head(done["links"]["result"])
    assert (head.status_code, head.content) == (200, b"")
    assert head.headers["content-length"] == response.headers["content-length"]
    again = running.client.get(done["links"]["result"], headers={"If-None-Match": response.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")


def test_result_ranges(running: Service, done: dict[str, Any]) -> None:
    link = done["links"]["result"]
    whole = running.client.get(link)
    size, etag = len(whole.content), whole.headers["etag"]
    for header, part in [("bytes=0-9", slice(0, 10)), ("bytes=100-", slice(100, None)), ("bytes=-7", slice(-7, None))]:
        response = running.client.get(link, headers={"Range": header, "If-Range": etag})
        assert (response.status_code, response.content) == (206, whole.content[part])
        assert response.headers["content-range"].endswith(f"/{size}")
        assert response.headers["repr-digest"] == whole.headers["repr-digest"]
        assert "content-digest" not in response.headers
    for ignored in ({"Range": "bytes=0-1,4-5"}, {"Range": "rows=1-2"}, {"Range": "bytes=0-" + "9" * 5000},
                    {"Range": f"bytes=-{'9' * 5000}"}, {"Range": "bytes=-"}, {"Range": "bytes=9-3"},
                    {"Range": "bytes=0-9", "If-Range": '"old"'}):  # fmt: skip
        response = running.client.get(link, headers=ignored)
        assert (response.status_code, response.content) == (200, whole.content), ignored
    response = running.client.get(link, headers={"Range": f"bytes={size}-"})
    assert (response.status_code, response.json()["code"]) == (416, "range_not_satisfiable")
    assert response.headers["content-range"] == f"bytes */{size}"


def test_result_in_the_other_format(running: Service, done: dict[str, Any], tmp_path: Path) -> None:
    link = done["links"]["result"]
    by_query = running.client.get(link, params={"format": "npz"})
    by_accept = running.client.get(link, headers={"Accept": "application/x-npz"})
    assert by_query.content == by_accept.content
    assert by_query.headers["content-type"] == "application/x-npz"
    assert "_denoised.npz" in by_query.headers["content-disposition"]
    ply, npz = _read(running.client.get(link), tmp_path), _read(by_query, tmp_path)
    np.testing.assert_array_equal(ply.points, npz.points)
    np.testing.assert_array_equal(ply.normals, npz.normals)
    assert ply.metadata == npz.metadata
    refused = running.client.get(link, headers={"Accept": "text/html"})
    assert (refused.status_code, refused.json()["code"]) == (406, "not_acceptable")
    for query in ("format=stl", "formats=ply"):
        response = running.client.get(f"{link}?{query}")
        assert (response.status_code, response.json()["code"]) == (422, "invalid_parameters")


def test_a_result_is_converted_once_when_it_is_asked_for(
    running: Service, done: dict[str, Any], tmp_path: Path
) -> None:
    link = done["links"]["result"]
    by_query = running.client.get(link, params={"format": "pcd"})
    assert (by_query.status_code, by_query.headers["content-type"]) == (200, "application/x-pcd")
    ply, pcd = _read(running.client.get(link), tmp_path), _read(by_query, tmp_path)
    np.testing.assert_array_equal(pcd.points, ply.points)
    np.testing.assert_array_equal(pcd.normals, ply.normals)
    assert pcd.metadata == ply.metadata
    again = running.client.get(link, headers={"Accept": "application/x-pcd", "If-None-Match": by_query.headers["etag"]})
    assert again.status_code == 304
    part = running.client.get(link, params={"format": "pcd"}, headers={"Range": "bytes=0-9"})
    assert (part.status_code, part.content) == (206, by_query.content[:10])
    assert running.client.get(link, params={"format": "csv"}).status_code == 200
    assert "no place for comments" in running.job(done["id"])["warnings"][-1]


def test_columns_of_text_come_back_as_they_were(running: Service, tmp_path: Path) -> None:
    words = [f"{i:03d},word {i}" for i in range(300)]
    rows = [",".join(map(repr, row)) for row in sphere(300).tolist()]
    lines = "\r\n".join(["X,Y,Z,id,label", *(f"{row},{word}" for row, word in zip(rows, words, strict=True))])
    (tmp_path / "table.csv").write_bytes(lines.encode())
    job = running.wait_status(running.submit(tmp_path / "table.csv")["id"], "succeeded", "failed")
    assert (job["status"], job["upload"]["format"]) == ("succeeded", "csv"), job
    response = running.client.get(job["links"]["result"])
    assert response.headers["content-type"].startswith("text/csv")
    head, *result = response.text.splitlines()
    assert head == "X,Y,Z,id,label,nx,ny,nz"
    assert [",".join(row.split(",")[3:5]) for row in result] == words
    assert "'label'" in " ".join(job["warnings"])  # what the PLY and the NPZ cannot hold
    assert running.client.get(job["links"]["result"], params={"format": "ply"}).status_code == 200


def test_display(running: Service, done: dict[str, Any], small: Path, tmp_path: Path) -> None:
    response = running.client.get(done["links"]["display"])
    assert response.headers["content-type"] == "model/gltf-binary"
    again = running.client.get(done["links"]["display"], headers={"If-None-Match": response.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    whole = running.client.get(done["links"]["display"], headers={"Range": "bytes=5-4,x"})
    assert (whole.status_code, whole.content) == (200, response.content)
    (tmp_path / "display").write_bytes(response.content)
    document, meshes = read_display(tmp_path / "display")
    before, after = read(small).points, _read(running.client.get(done["links"]["result"]), tmp_path)
    moved = np.linalg.norm(after.points.astype(np.float64) - before, axis=1)
    extras = document["asset"]["extras"]
    assert extras["points"] == len(before)
    assert extras["displacement"]["mean"] == pytest.approx(moved.mean(), rel=1e-4)
    raw = pca_normals(before)
    # The order is another one, the same in every array.
    order = [np.lexsort(np.round(points, 4).T) for points in (meshes["before"]["POSITION"] + extras["centre"], before)]
    np.testing.assert_allclose((meshes["after"]["POSITION"] + extras["centre"])[order[0]], after.points[order[1]],
                               atol=1e-5)  # fmt: skip
    for normals, mesh in ((after.normals, "after"), (raw, "before")):
        assert normals is not None
        cosine = np.abs(np.einsum("ni,ni->n", meshes[mesh]["NORMAL"][order[0], :3] / 127.0, normals[order[1]]))
        assert np.median(cosine) > 0.999, mesh


def test_display_of_a_job_that_has_none(running: Service, small: Path) -> None:
    job = running.submit(small)
    early = running.client.get(f"/jobs/{job['id']}/display")
    assert (early.status_code, early.json()["code"]) == (409, "job_not_finished")
    job = running.wait_status(job["id"], "succeeded")
    (running.data / "jobs" / job["id"] / "display.glb").unlink()
    response = running.client.get(job["links"]["display"])
    assert (response.status_code, response.json()["code"]) == (404, "display_not_found")
    assert "older version" in response.json()["detail"]


def test_everything_in_a_ply_comes_back(running: Service, tmp_path: Path) -> None:
    count = 300
    random = np.random.default_rng(1)
    centre = np.array([443_210.25, 4_480_000.125, 812.5])  # UTM
    cloud = PointCloud(
        points=sphere(count) * 5 + centre,
        attributes={
            "red": random.integers(0, 256, count).astype(np.uint8),
            "intensity": random.normal(size=count).astype(np.float32),
        },
        comments=["scanned on a Tuesday"],
        flavour=PlyFlavour(
            encoding="ascii",
            properties=(("red", "uchar"), ("x", "double"), ("intensity", "float"), ("y", "double"), ("z", "double")),
        ),
    )
    write(tmp_path / "utm.ply", cloud)
    job = running.wait_status(running.submit(tmp_path / "utm.ply")["id"], "succeeded")
    result = _read(running.client.get(job["links"]["result"]), tmp_path)
    assert result.points.dtype == np.float64
    assert np.linalg.norm(result.points - cloud.points, axis=1).max() < 2
    assert np.abs(np.linalg.norm(result.points - centre, axis=1) - 5).mean() < 0.06
    assert result.comments == ["scanned on a Tuesday"]
    assert isinstance(result.flavour, PlyFlavour)
    assert result.flavour.encoding == "ascii"
    assert [name for name, _ in result.flavour.properties if name[0] != "n"] == ["red", "x", "intensity", "y", "z"]
    for name, column in cloud.attributes.items():
        np.testing.assert_array_equal(result.attributes[name], column)


def test_an_npz_comes_back_as_npz(running: Service, tmp_path: Path) -> None:
    points = sphere(300)
    np.savez(tmp_path / "a.npz", xyz=points, normals=points, label=np.arange(300))
    job = running.wait_status(running.submit(tmp_path / "a.npz", normals="input")["id"], "succeeded", "failed")
    response = running.client.get(job["links"]["result"])
    assert response.headers["content-type"] == "application/x-npz"
    with np.load(io.BytesIO(response.content)) as result:
        assert result["xyz"].shape == result["normals"].shape == (300, 3)
        assert (np.einsum("ni,ni->n", result["normals"], points) > 0).all()
        np.testing.assert_array_equal(result["label"], np.arange(300))
    assert isinstance(_read(response, tmp_path).flavour, NpzFlavour)


def test_same_input_same_output(running: Service, done: dict[str, Any], small: Path) -> None:
    again = running.wait_status(running.submit(small, iterations=2, seed=3)["id"], "succeeded")
    first, second = (running.client.get(job["links"]["result"]).content for job in (done, again))
    assert first == second


def test_a_job_that_fails_says_why(running: Service, tmp_path: Path) -> None:
    points = np.zeros((40, 3))
    points[:, 0] = np.linspace(0, 1, 40)
    write(tmp_path / "line.ply", PointCloud(points=points))
    job = running.wait_status(running.submit(tmp_path / "line.ply")["id"], "succeeded", "failed")
    response = running.client.get(f"/jobs/{job['id']}/result")
    if job["status"] == "succeeded":  # degenerate, but a finite result is as good
        assert np.isfinite(_read(response, tmp_path).points).all()
    else:
        assert job["problem"]["instance"] == f"/jobs/{job['id']}"
        assert (response.status_code, response.json()["code"]) == (409, "job_failed")
        assert response.json()["cause"] == job["problem"]["code"]


def test_list(running: Service, done: dict[str, Any]) -> None:
    jobs = running.client.get("/jobs", params={"limit": 100}).json()
    assert done["id"] in [job["id"] for job in jobs]
    assert [job["created_at"] for job in jobs] == sorted((job["created_at"] for job in jobs), reverse=True)
    older = running.client.get("/jobs", params={"before": jobs[0]["id"], "limit": 1}).json()
    assert older[0]["id"] == jobs[1]["id"]
    for query in ("limit=0", "limit=101", "before=x", "page=2"):
        assert running.client.get(f"/jobs?{query}").json()["code"] == "invalid_parameters"


def test_ignored_classes_and_the_type_of_coordinates_hold_in_every_format(running: Service, tmp_path: Path) -> None:
    origin = np.array([500_000.0, 5_400_000, 0])
    points = np.concatenate([sphere(300), [[4, 4, 4], [5, 5, 5]]]) + origin
    classes = np.r_[np.full(300, 2), 7, 18].astype(np.uint8)
    write(tmp_path / "a.las", PointCloud(points=points, attributes={"classification": classes}), format="las")
    given = read(tmp_path / "a.las").points
    job = running.submit(tmp_path / "a.las", iterations=1, ignore_classes="7,18", coordinates="float32")
    job = running.wait_status(job["id"], "succeeded", "failed")
    assert job["status"] == "succeeded", job["problem"]
    assert (job["upload"]["points"], job["progress"]["total"]) == (300, 300)
    assert any("2 points of the classes 7, 18" in warning for warning in job["warnings"])
    for format_ in ("las", "ply", "pcd"):
        content = running.client.get(f"{job['links']['self']}/result?format={format_}").content
        (tmp_path / "b").write_bytes(content)
        cloud = read(tmp_path / "b")
        shift = np.array(cloud.metadata["offset"].split(), float) if format_ != "las" else 0
        assert cloud.points.dtype == (np.float64 if format_ == "las" else np.float32)
        moved = np.abs(cloud.points + shift - given).max(axis=1)
        assert moved[:300].max() > 1e-3 > moved[300:].max()


def _grid(width: int) -> tuple[np.ndarray, list[tuple[int, ...]]]:
    """Noisy vertices of a plane, and faces of three and of four corners between them."""
    plane = np.stack(np.meshgrid(np.arange(width), np.arange(width)), axis=-1).reshape(-1, 2)
    points = np.c_[plane, np.random.default_rng(0).normal(0, 0.2, len(plane))].astype("<f4")
    faces: list[tuple[int, ...]] = []
    for corner in (row * width + column for row in range(width - 1) for column in range(width - 1)):
        right, above, across = corner + 1, corner + width, corner + width + 1
        faces += [(corner, right, across, above)] if corner % 3 else [(corner, right, across), (corner, across, above)]
    return points, faces


def test_a_mesh_comes_back_with_its_faces_unchanged(running: Service, tmp_path: Path) -> None:
    points, faces = _grid(20)
    lines = (f"element face {len(faces)}", "property list uchar int vertex_indices", "property uchar red")
    rows = b"".join(struct.pack(f"<B{len(face)}iB", len(face), *face, face[0] % 256) for face in faces)
    flavour = PlyFlavour(after=(Block("face", lines, rows),))
    write(tmp_path / "mesh.ply", PointCloud(points=points, flavour=flavour))
    obj = [*(f"v {x} {y} {z}" for x, y, z in points.tolist()), *(f"f {' '.join(str(i + 1) for i in f)}" for f in faces)]
    (tmp_path / "mesh.obj").write_text("\n".join(obj))
    jobs = {name: running.submit(tmp_path / name, iterations=1) for name in ("mesh.ply", "mesh.obj")}
    for name, job in jobs.items():
        job = running.wait_status(job["id"], "succeeded", "failed")
        assert job["status"] == "succeeded", job["problem"]
        content = running.client.get(f"{job['links']['self']}/result").content
        (tmp_path / "result.ply").write_bytes(content)
        cloud = read(tmp_path / "result.ply")
        assert isinstance(cloud.flavour, PlyFlavour)
        (block,) = cloud.flavour.after
        bare = b"".join(struct.pack(f"<B{len(face)}i", len(face), *face) for face in faces)
        assert block.lines == (lines if name == "mesh.ply" else lines[:2])
        assert block.body == (rows if name == "mesh.ply" else bare)
        assert content.endswith(block.body)
        moved = np.abs(cloud.points - points)
        assert (moved.max(axis=1) > 0).mean() > 0.5, "its vertices are denoised"
        assert np.abs(cloud.points[:, 2]).mean() < np.abs(points[:, 2]).mean()


def test_classes_of_a_cloud_without_any_are_refused(api: httpx.Client, small: Path) -> None:
    response = api.post("/denoise?ignore_classes=7", files={"file": small.read_bytes()})
    assert (response.status_code, response.json()["code"]) == (422, "missing_column")

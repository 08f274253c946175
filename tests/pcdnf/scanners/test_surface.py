import sys

import numpy as np
import pytest

from pcdnf.errors import PcdnfError
from pcdnf.scanners.scene import Scene, SceneBuilder
from pcdnf.scanners.solids import box, sphere
from pcdnf.scanners.surface import Surface


def scene() -> Scene:
    builder = SceneBuilder()
    builder.add("box", box([1000, 0, 0], [1001, 1, 1]))
    builder.add("ball", sphere([1003, 0, 0], 0.5, 64))
    return builder.build()


def test_a_ray_ends_at_the_first_face_to_the_last_digit() -> None:
    surface = Surface(scene())
    origins = np.array([[1000.3, 0.4, 7.0], [1000.3, 0.4, 7.0]])
    hits = surface.cast(origins, np.array([[0, 0, -1.0], [0, 0, 1.0]]))
    assert hits.distance[0] == pytest.approx(6.0, abs=1e-12)
    assert np.isinf(hits.distance[1])
    assert hits.face[1] == -1
    assert surface.scene.part_names[surface.scene.face_part[hits.face[0]]] == "box"
    assert np.allclose(np.abs(surface.normals[hits.face[0]]), [0, 0, 1])


def test_nearest_points_lie_on_faces_edges_and_corners() -> None:
    surface = Surface(scene())
    points = np.array([[1000.2, 0.3, 1.4], [1000.5, -0.3, 1.4], [999.0, -1.0, -1.0]])
    nearest = surface.nearest(points)
    assert np.allclose(nearest.points, [[1000.2, 0.3, 1], [1000.5, 0, 1], [1000, 0, 0]], atol=1e-9)
    assert np.allclose(nearest.distance, [0.4, 0.5, np.sqrt(3)], atol=1e-9)


def test_nearest_points_on_a_ball_are_along_its_radii() -> None:
    surface = Surface(scene())
    direction = np.random.default_rng(0).normal(size=(200, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[:, 0] = np.abs(direction[:, 0])
    nearest = surface.nearest([1003, 0, 0] + 0.6 * direction)
    assert np.allclose(nearest.distance, 0.1, atol=2e-3)


def test_without_open3d_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(PcdnfError, match="not installed") as caught:
        Surface(scene())
    assert "pcdnf[scanners]" in str(caught.value.hint)

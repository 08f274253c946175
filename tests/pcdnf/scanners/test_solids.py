import numpy as np
import pytest

from pcdnf.scanners.scene import Mesh, SceneBuilder
from pcdnf.scanners.solids import box, cylinder, height_field, hexahedron, moved, sagging, sphere, tube, turned

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


def volume(mesh: Mesh) -> float:
    """Signed: positive where all faces point outwards."""
    a, b, c = np.moveaxis(mesh[0][mesh[1]], 1, 0)
    return float((a * np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize(
    ("mesh", "expected", "tolerance"),
    [
        (box([1, 2, 3], [2, 4, 6]), 6.0, 1e-9),
        (cylinder([5, 5, 5], 2.0, 0.5, 96), np.pi / 2, 2e-3),
        (tube([[0, 0, 0], [3, 0, 0]], 0.1, 96), 0.03 * np.pi, 2e-3),
        (tube([[0, 0, 0], [0, 2, 0], [0, 3, 0]], 0.2, 96), 0.12 * np.pi, 2e-3),
        (sphere([1, 0, 0], 2.0, 48), 32 * np.pi / 3, 5e-3),
        (hexahedron(2 * SQUARE, SQUARE + [0, 0, 1]), 7 / 3, 0.05),
    ],
)
def test_pieces_are_closed_and_face_outwards(mesh: Mesh, expected: float, tolerance: float) -> None:
    assert volume(mesh) == pytest.approx(expected, rel=tolerance)
    edges = np.sort(np.concatenate([mesh[1][:, [0, 1]], mesh[1][:, [1, 2]], mesh[1][:, [2, 0]]]), axis=1)
    solid = volume(moved(mesh, [100, -50, 30]))
    assert solid == pytest.approx(volume(mesh), rel=1e-6)  # an open mesh would have another one elsewhere
    assert len(np.unique(edges, axis=0)) * 2 >= len(edges)


def test_a_turned_piece_keeps_its_axis() -> None:
    vertices, _ = turned(box([0, 0, 0], [2, 1, 1]), np.pi / 2, [1, 0, 0])
    assert np.allclose(vertices.min(0), [0, -1, 0])
    assert np.allclose(vertices.max(0), [1, 1, 1])


def test_a_wire_sags_in_its_middle() -> None:
    path = sagging([0, 0, 5], [10, 0, 5], 0.4, 11)
    assert path[5, 2] == pytest.approx(4.6)
    assert np.allclose(path[[0, -1], 2], 5)


def test_a_height_field_faces_upwards() -> None:
    axis = np.linspace(0, 1, 5)
    scene = SceneBuilder()
    scene.add("ground", height_field(axis, axis, lambda x, y: 0.1 * x * y))
    assert (scene.build().face_normals()[:, 2] > 0.9).all()


def test_a_scene_knows_its_parts() -> None:
    builder = SceneBuilder()
    builder.add("wall", box([0, 0, 0], [1, 0.2, 1]))
    builder.add("wire", tube([[0, 0, 2], [1, 0, 2]], 0.01), thin=True)
    builder.add("wall", box([0, 1, 0], [1, 1.2, 1]))
    scene = builder.build()
    assert scene.part_names == ("wall", "wire")
    assert scene.thin.tolist() == [False, True]
    assert (scene.face_part == 0).sum() == 24
    assert scene.face_areas()[scene.face_part == 0].sum() == pytest.approx(2 * (2 * 1 + 4 * 0.2))

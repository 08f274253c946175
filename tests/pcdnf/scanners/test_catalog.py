import numpy as np
import pytest
from scipy.spatial import cKDTree

from pcdnf.errors import PcdnfError
from pcdnf.scanners.catalog import KINDS, simulate
from pcdnf.scanners.scan import Scan
from pcdnf.scanners.surface import Surface

POINTS = 3000


@pytest.fixture(scope="module")
def scans() -> dict[str, Scan]:
    return {kind: simulate(kind, 4, POINTS) for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
def test_a_scan_is_the_same_for_the_same_seed_alone(scans: dict[str, Scan], kind: str) -> None:
    scan, again, other = scans[kind], simulate(kind, 4, POINTS), simulate(kind, 5, POINTS)
    assert np.array_equal(scan.points, again.points)
    assert np.array_equal(scan.sigma, again.sigma)
    assert scan.points.shape != other.points.shape or not np.array_equal(scan.points, other.points)


@pytest.mark.parametrize("kind", KINDS)
def test_a_scan_has_about_as_many_points_as_asked_for(scans: dict[str, Scan], kind: str) -> None:
    assert POINTS / 3 < len(scans[kind].points) < POINTS * 2


@pytest.mark.parametrize("kind", KINDS)
def test_true_points_lie_on_the_mesh_and_normals_face_the_sensor(scans: dict[str, Scan], kind: str) -> None:
    scan = scans[kind]
    nearest = Surface(scan.scene).nearest(scan.clean)
    assert nearest.distance.max() < 1e-5 * np.ptp(scan.scene.vertices)
    assert np.allclose(np.linalg.norm(scan.normals, axis=1), 1)
    ray = scan.sensors[scan.station] - scan.clean
    assert (ray * scan.normals).sum(1).min() >= 0
    assert scan.part.max() < len(scan.scene.part_names)


@pytest.mark.parametrize("kind", KINDS)
def test_points_are_off_the_surface_by_what_sigma_tells(scans: dict[str, Scan], kind: str) -> None:
    scan = scans[kind]
    good = ~scan.mixed
    ray = scan.sensors[scan.station] - scan.clean
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    across = np.abs((ray * scan.normals).sum(1)) if kind not in ("photogrammetry", "graded") else np.ones(len(ray))
    error = np.abs(((scan.points - scan.clean) * scan.normals).sum(1) / scan.sigma) / 0.6745
    assert np.median(error[good]) < 1.3
    assert np.median((error / np.maximum(across, 0.05))[good]) > 0.4  # of errors along the ray only so much shows
    assert 0 <= scan.mixed.mean() < 0.25


def test_thin_parts_are_seen(scans: dict[str, Scan]) -> None:
    assert all(scans[kind].thin.any() for kind in ("terrestrial-room", "terrestrial-street", "mobile-street"))
    assert any(scan.mixed.any() for scan in scans.values())


def test_steps_of_a_depth_camera_grow_with_the_square_of_the_depth() -> None:
    scan = simulate("depth-frame", 4, 20_000)
    distance = np.linalg.norm(scan.clean - scan.sensors[0], axis=1)
    far, near = distance > np.percentile(distance, 90), distance < np.percentile(distance, 10)
    ratio = np.median(scan.sigma[far]) / np.median(scan.sigma[near])
    square = (np.median(distance[far]) / np.median(distance[near])) ** 2
    assert 0.4 * square < ratio < 1.3 * square


def test_layers_of_a_turntable_do_not_fit(scans: dict[str, Scan]) -> None:
    scan = scans["structured-light"]
    error = ((scan.points - scan.clean) * scan.normals).sum(1)
    # one view's shift shows where its points face the same way
    means = [
        error[(scan.station == view) & (scan.normals[:, 2] > 0.9)].mean()
        for view in range(len(scan.sensors))
        if ((scan.station == view) & (scan.normals[:, 2] > 0.9)).sum() > 20
    ]
    assert len(means) > 2
    assert np.std(means) > 0.2 * np.std(error)


def test_errors_of_matching_are_alike_nearby() -> None:
    scan = simulate("photogrammetry", 4, 15_000)
    good = ~scan.mixed
    error = (((scan.points - scan.clean) * scan.normals).sum(1) / scan.sigma)[good]
    tree = cKDTree(scan.clean[good])
    near = tree.query(scan.clean[good], [2])[1][:, 0]
    far = tree.query(scan.clean[good], [len(error) // 20])[1][:, 0]
    assert np.corrcoef(error, error[near])[0, 1] > 0.4
    assert abs(np.corrcoef(error, error[far])[0, 1]) < 0.25


def test_spacing_along_and_across_lines_differs() -> None:
    scan = simulate("mobile-street", 4, 30_000)
    ground = np.flatnonzero(scan.part == scan.scene.part_names.index("ground"))
    lines = np.diff(np.flatnonzero(np.diff(scan.station[ground])))
    step = np.linalg.norm(np.diff(scan.clean[ground], axis=0), axis=1)
    along = np.median(step[np.diff(scan.station[ground]) == 0])
    across = np.median(np.linalg.norm(np.diff(scan.sensors[:50], axis=0), axis=1))
    assert len(lines) > 20
    assert not 0.8 < along / across < 1.25


def test_an_unknown_kind_is_refused() -> None:
    with pytest.raises(PcdnfError, match="no kind of scan named 'sonar'") as caught:
        simulate("sonar", 0)
    assert "depth-frame" in str(caught.value.hint)

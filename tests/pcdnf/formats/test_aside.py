"""Points that no fit uses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pcdnf.formats import FormatError, Limits, PointCloud, read, write
from pcdnf.formats.aside import points_to_fit, without_classes

OPACITIES = np.array([0.05, 0.099, 0.101, 0.9])


def splats(opacities: np.ndarray, **columns: np.ndarray) -> PointCloud:
    """Splats in a row, whose opacities are stored as logits."""
    count = len(opacities)
    points = np.arange(3.0 * count).reshape(count, 3)
    names = ("f_dc_0", "scale_0", "rot_0")
    logit = np.log(opacities / (1 - opacities))
    return PointCloud(points=points, attributes={name: np.ones(count) for name in names} | {"opacity": logit} | columns)


def test_faint_splats_are_put_aside_and_come_back() -> None:
    cloud = splats(np.tile(OPACITIES, 50))
    fitted = points_to_fit(cloud)
    np.testing.assert_array_equal(fitted.file_rows() % 4, np.tile([2, 3], 50))
    assert fitted.warnings == ["100 of 200 splats have an opacity below 10% and were left as they are."]
    whole = fitted.replaced(fitted.points + 1, None).whole()
    np.testing.assert_array_equal((whole.points - cloud.points)[:, 0], np.tile([0, 0, 1, 1], 50))
    np.testing.assert_array_equal(whole.attributes["opacity"], cloud.attributes["opacity"])


def test_an_opacity_that_is_not_a_number_is_faint() -> None:
    cloud = splats(np.full(200, 0.9))
    cloud.attributes["opacity"][7] = np.nan
    assert 7 not in points_to_fit(cloud).file_rows()


def test_splats_are_all_used_where_few_are_clear_and_other_clouds_whatever_their_columns() -> None:
    few = splats(np.tile(OPACITIES, 49))
    assert points_to_fit(few) is few
    other = splats(np.tile(OPACITIES, 50))
    del other.attributes["rot_0"]
    assert points_to_fit(other) is other


def test_classes_and_faint_splats_are_put_aside_together() -> None:
    cloud = splats(np.tile(OPACITIES, 60), classification=np.repeat([2, 7], [220, 20]).astype(np.uint8))
    fitted = points_to_fit(cloud, (7,))
    assert (len(fitted), len(fitted.whole())) == (110, 240)
    np.testing.assert_array_equal(fitted.whole().points, cloud.points)


def test_points_put_aside_come_back_as_they_are(tmp_path: Path) -> None:
    classes = np.array([2, 7, 2, 18, 2, 2], np.uint8)
    points = np.random.default_rng(0).normal(size=(6, 3))
    points[4] = np.nan
    cloud = PointCloud(points=points, normals=np.ones((6, 3)), attributes={"classification": classes})
    write(tmp_path / "a.ply", cloud)
    given = read(tmp_path / "a.ply")
    rest = without_classes(given, (7, 18))
    assert len(rest) == 3
    assert "2 points of the classes 7, 18 were left as they are." in rest.warnings
    assert without_classes(given, ()) is given
    with pytest.raises(FormatError, match="3 points; at least 4"):
        without_classes(given, (7, 18), Limits(minimum_points=4))
    whole = rest.replaced(rest.points + 1, -np.ones((3, 3))).whole()
    np.testing.assert_array_equal(whole.points[[1, 3]], points[[1, 3]])
    np.testing.assert_array_equal(whole.points[[0, 2, 5]], points[[0, 2, 5]] + 1)
    assert np.isnan(whole.points[4]).all()
    write(tmp_path / "b.las", rest, format="las", check=True)
    assert read(tmp_path / "b.las").attributes["classification"].tolist() == [2, 7, 2, 18, 2]


def test_too_many_ignored_classes_are_named() -> None:
    cloud = PointCloud(
        points=np.random.default_rng(0).normal(size=(60, 3)), attributes={"classification": np.full(60, 7, np.uint8)}
    )
    with pytest.raises(FormatError, match="Without the classes 7 the cloud has 0 points") as caught:
        points_to_fit(cloud, [7])
    assert caught.value.code == "too_few_points"
    assert caught.value.hint == "Ignore fewer classes."

import numpy as np

from pcdnf.formats import PointCloud
from pcdnf.formats.attributes import with_columns
from pcdnf.formats.point_cloud import Holes

COLUMN = np.array([0.5, 0.25], np.float32)


def test_a_column_whose_name_is_taken_gets_another() -> None:
    cloud = PointCloud(points=np.eye(3)[:2], attributes={"Confidence": np.array([7, 8], np.uint8)})
    found = with_columns(cloud, {"confidence": COLUMN, "displacement": COLUMN})
    assert list(found.attributes) == ["Confidence", "pcdnf_confidence", "displacement"]
    np.testing.assert_array_equal(found.attributes["Confidence"], [7, 8])
    np.testing.assert_array_equal(found.attributes["pcdnf_confidence"], COLUMN)
    assert list(cloud.attributes) == ["Confidence"]


def test_rows_without_coordinates_have_no_value() -> None:
    holes = Holes(np.array([1]), np.full((1, 3), np.nan), None, {})
    cloud = PointCloud(points=np.eye(3)[:2], holes=holes)
    whole = with_columns(cloud, {"displacement": COLUMN}).whole()
    np.testing.assert_array_equal(whole.attributes["displacement"], np.array([0.5, np.nan, 0.25], np.float32))

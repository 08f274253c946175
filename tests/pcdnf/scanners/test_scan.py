from pathlib import Path

import numpy as np
import pytest

from pcdnf.errors import PcdnfError
from pcdnf.scanners.catalog import simulate
from pcdnf.scanners.scan import Scan, load_scan, save_scan


@pytest.fixture(scope="module")
def scan() -> Scan:
    return simulate("depth-frame", 3, 4000)


def test_a_scan_comes_back_from_its_file(scan: Scan, tmp_path: Path) -> None:
    save_scan(tmp_path / "scan.npz", scan)
    again = load_scan(tmp_path / "scan.npz")
    assert np.array_equal(again.points, scan.points)
    assert np.array_equal(again.clean, scan.clean)
    assert np.allclose(again.normals, scan.normals, atol=1e-6)
    assert np.array_equal(again.mixed, scan.mixed)
    assert again.scene.part_names == scan.scene.part_names
    assert np.array_equal(again.thin, scan.thin)
    assert (again.name, again.unit) == (scan.name, scan.unit)


def test_true_points_that_a_file_lacks_are_taken_from_its_mesh(scan: Scan, tmp_path: Path) -> None:
    save_scan(tmp_path / "whole.npz", scan)
    with np.load(tmp_path / "whole.npz") as arrays:
        fewer = {key: arrays[key] for key in arrays.files if key not in ("clean", "normals", "loose")}
    np.savez(tmp_path / "fewer.npz", **fewer)
    again = load_scan(tmp_path / "fewer.npz")
    assert np.linalg.norm(again.points - again.clean, axis=1).max() <= (
        np.linalg.norm(scan.points - scan.clean, axis=1).max() + 1e-9
    )
    assert np.allclose(np.linalg.norm(again.normals, axis=1), 1)


def test_a_file_that_is_no_scan_is_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", points=np.zeros((3, 3)))
    with pytest.raises(PcdnfError, match=r"other\.npz is not a scan") as caught:
        load_scan(tmp_path / "other.npz")
    assert caught.value.code == "bad_scan"


def test_rows_of_a_scan_stay_together(scan: Scan) -> None:
    some = scan.rows(~scan.mixed)
    assert not some.mixed.any()
    assert len(some.points) == len(some.sigma) == len(some.normals) == (~scan.mixed).sum()

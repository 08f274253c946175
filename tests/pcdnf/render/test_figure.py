"""``pcdnf render``: what is in the picture, by its pixels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from pcdnf.cli.main import main
from pcdnf.formats import PointCloud, write
from pcdnf.render.camera import named
from pcdnf.render.colour_maps import ColourScale
from pcdnf.render.views import UPS, VIEWS

COUNT = 4000


def sphere(noise: float = 0.0) -> NDArray[np.float64]:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(COUNT, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points * (1 + rng.uniform(-noise, noise, size=(COUNT, 1)))


@pytest.fixture
def files(tmp_path: Path) -> dict[str, str]:
    red = {"red": np.full(COUNT, 200, "u1"), "green": np.zeros(COUNT, "u1"), "blue": np.zeros(COUNT, "u1")}
    clouds = {
        "before.ply": PointCloud(points=sphere(0.1), attributes=red),
        "after.npz": PointCloud(points=sphere(), attributes=red),
        "clean.ply": PointCloud(points=sphere()),
        "few.ply": PointCloud(points=sphere()[:50]),
    }
    for name, cloud in clouds.items():
        write(tmp_path / name, cloud, format=Path(name).suffix[1:])
    return {Path(name).stem: str(tmp_path / name) for name in clouds}


def drawn(tmp_path: Path, *arguments: str) -> NDArray[Any]:
    path = tmp_path / "out.png"
    assert main(["render", *arguments, "-o", str(path)]) == 0
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"), np.float64)


def share(picture: NDArray[Any], colour: NDArray[Any], within: float = 40) -> float:
    """Part of the pixels that are about of a colour."""
    return float((np.abs(picture - colour).max(axis=2) < within).mean())


def red_part(picture: NDArray[Any]) -> float:
    return float(((picture[..., 0] > 60) & (picture[..., 1:].max(axis=2) < 30)).mean())


def test_before_after_and_displacement(files: dict[str, str], tmp_path: Path) -> None:
    picture = drawn(tmp_path, files["before"], files["after"], "--size", "900x300", "--no-detail")
    assert picture.shape == (300, 900, 3)
    before, after, moved = picture[:, :300], picture[:, 300:600], picture[:, 600:]
    assert red_part(before) > 0.1
    assert red_part(after) > 0.1
    assert red_part(moved) < 0.01, "the map has colours of its own"
    low, high = (ColourScale(0.1, False).colours(np.array([value]))[0] ** (1 / 2.2) * 255 for value in (0.005, 0.095))
    assert share(moved, low) > 0.005
    assert share(moved, high) > 0.005
    assert share(after, high) < 0.001


def test_error_maps_share_one_scale(files: dict[str, str], tmp_path: Path) -> None:
    arguments = [files["before"], files["after"], "--clean", files["clean"], "--size", "600x600", "--no-detail"]
    picture = drawn(tmp_path, *arguments)
    lower = picture[300:540]
    lowest = ColourScale(1.0, False).colours(np.array([0.0]))[0] ** (1 / 2.2) * 255
    assert share(lower[:, 300:], lowest) > 0.1, "nothing is left of the error"
    assert share(lower[:, :300], lowest) < 0.06
    assert red_part(picture[:300]) > 0.1


def test_sizes_follow_the_panels_unless_given(files: dict[str, str], tmp_path: Path) -> None:
    assert drawn(tmp_path, files["few"], "--no-detail").shape == (900, 1000, 3)
    one = drawn(tmp_path, files["before"], "--clean", files["clean"], "--size", "400x200")
    assert one.shape == (200, 400, 3)
    none = drawn(tmp_path, files["before"], files["after"], "--map", "none", "--size", "400x200", "--plain")
    assert red_part(none) == 0


def test_clouds_of_other_sizes_have_no_displacement(
    files: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert drawn(tmp_path, files["before"], files["few"], "--size", "400x200").shape == (200, 400, 3)
    output = ["-o", str(tmp_path / "x.png")]
    for arguments, message in (
        ([files["before"], files["few"], "--map", "displacement"], "4,000 and 50 points"),
        ([files["before"], "--map", "displacement"], "needs two clouds"),
        ([files["before"], "--map", "error"], "--clean"),
        ([files["before"], "--labels", "a", "b"], "2 labels for 1"),
        ([str(tmp_path / "none.ply")], "cannot be read"),
        ([files["before"], "-o", str(tmp_path / "no" / "x.png")], "folder does not exist"),
    ):
        assert main(["render", *output, *arguments]) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "x.png").exists()


@pytest.mark.parametrize("size", ["1600", "10x10", "axb", "99999x900"])
def test_sizes_that_are_none(files: dict[str, str], size: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["render", files["before"], "-o", "x.png", "--size", size])
    assert "1600x900" in capsys.readouterr().err


@pytest.mark.parametrize("up", UPS)
@pytest.mark.parametrize("view", VIEWS)
def test_named_views(view: str, up: str) -> None:
    camera = named(view, up, sphere())
    np.testing.assert_allclose(camera.axes @ camera.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(camera.axes) == pytest.approx(1)
    upright = np.eye(3)["xyz".index(up[-1])] * (-1 if up[0] == "-" else 1)
    if view in ("top", "bottom"):
        assert camera.axes[2] @ upright == pytest.approx(1 if view == "top" else -1)
    else:
        assert camera.axes[1] @ upright > 0.7


def test_from_the_front_x_runs_right_and_z_up() -> None:
    camera = named("front", "z", sphere())
    np.testing.assert_allclose(camera.axes, [[1, 0, 0], [0, 0, 1], [0, -1, 0]], atol=1e-12)


def test_the_title_keeps_clear_of_the_detail(tmp_path: Path) -> None:
    plane = np.random.default_rng(0).uniform(-1, 1, size=(COUNT, 2))
    corner = plane[plane.sum(axis=1) > -0.6]  # nothing at the lower left, where the detail goes
    write(tmp_path / "corner.ply", PointCloud(points=np.c_[corner, np.zeros(len(corner))]))
    view = ["--view", "front", "--up", "y", "--size", "300x300", "--labels", " "]
    without = drawn(tmp_path, str(tmp_path / "corner.ply"), *view, "--title", "")
    titled = drawn(tmp_path, str(tmp_path / "corner.ply"), *view, "--title", "Title")
    _, columns = np.nonzero((titled != without).any(axis=2))
    assert columns.min() > 200

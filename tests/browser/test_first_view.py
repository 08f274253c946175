"""The first view of a cloud: what is up, from where it is seen, how large points are, and the address that keeps it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from playwright.sync_api import Page, expect

from pcdnf.formats import PointCloud, write
from tests.support.service_process import Service, sphere
from tests.support.viewing import PHONE, MakePage, base, canvas, choose, share_different, share_drawn, wait_state

Array = NDArray[Any]

FIRST_VIEW = """async ([points, normals, box, centre]) => {
    const { firstView, sensorSide } = await import('/viewer/first_view.js');
    const display = { box, centre, after: { POSITION: Float32Array.from(points), NORMAL: Int8Array.from(normals) } };
    return [firstView(display), sensorSide(display)];
}"""
SPACINGS = """async (points) => {
    const { spacings } = await import('/viewer/spacing.js');
    return [...spacings(Float32Array.from(points))];
}"""


def _first_view(page: Page, points: Array, normals: Array) -> Any:
    """Return what the page's module finds for a cloud in the axes of its file."""
    low, high = np.quantile(points, (0.01, 0.99), axis=0)
    centre = (low + high) / 2
    packed = np.rint(np.pad(normals, ((0, 0), (0, 1))) * 127)
    box = [(low - centre).tolist(), (high - centre).tolist()]
    return page.evaluate(
        FIRST_VIEW, [(points - centre).ravel().tolist(), packed.ravel().tolist(), box, centre.tolist()]
    )


def _depth_frame() -> tuple[Array, Array]:
    """A wall with a box before it, as a camera at the origin sees them that looks along Z with Y down."""
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 90), np.linspace(-0.4, 0.4, 70))
    depth = np.where((abs(u) < 0.15) & (abs(v) < 0.2), 2.0, 3.0).ravel()
    points = np.stack([u.ravel() * depth, v.ravel() * depth, depth], axis=1)
    return points, np.tile([0.0, 0.0, -1.0], (len(points), 1))


@pytest.fixture
def page(running: Service, make_page: MakePage) -> Page:
    """The start page."""
    page = make_page(base(running))
    page.goto("/")
    return page


@pytest.mark.parametrize(
    ("turn", "up"),
    [
        (np.eye(3), "-y"),  # as depth cameras have it
        (np.diag([1.0, -1.0, -1.0]), "y"),  # as OpenGL has it
        (np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), "z"),  # as robots have it: X ahead, Z up
    ],
)
def test_a_depth_frame_opens_from_its_sensor(page: Page, turn: Array, up: str) -> None:
    points, normals = _depth_frame()
    found, side = _first_view(page, points @ turn.T, normals @ turn.T)
    assert found["up"] == up
    np.testing.assert_allclose(found["direction"], turn @ [0, 0, -1], atol=0.1)
    assert side == found["direction"]


def test_a_whole_object_has_no_sensor_side(page: Page) -> None:
    ball = sphere(6000)
    _, side = _first_view(page, ball + np.array([0, 0, 4]), ball)
    assert side is None


def test_a_floor_decides_between_y_and_z(page: Page) -> None:
    random = np.random.default_rng(0)
    floor = np.c_[random.uniform(-1, 1, (3000, 2)), np.zeros(3000)]
    post = np.c_[0.1 * sphere(3000)[:, :2], random.uniform(0, 1, 3000)]
    points = np.r_[floor, post]
    normals = np.r_[np.tile([0.0, 0, 1], (3000, 1)), np.tile([0.6, 0.8, 0], (3000, 1))]
    assert _first_view(page, points, normals)[0]["up"] == "z"
    assert _first_view(page, points[:, [1, 2, 0]], normals[:, [1, 2, 0]])[0]["up"] == "y"


def test_the_side_with_most_to_see_is_chosen(page: Page) -> None:
    random = np.random.default_rng(0)
    sheet = np.c_[np.zeros(5000), random.uniform(-1, 1, (5000, 2))]  # seen squarely along X
    found, _ = _first_view(page, sheet, np.tile([1.0, 0, 0], (5000, 1)))
    assert abs(found["direction"][0]) > 0.75
    assert found["direction"][2] == pytest.approx(0.527, abs=0.01)


def test_spacing_is_that_around_each_point(page: Page) -> None:
    random = np.random.default_rng(0)
    dense = np.c_[random.uniform(0, 1, (6000, 2)), np.zeros(6000)]
    sparse = np.c_[random.uniform(0, 1, (1500, 2)) + np.array([3, 0]), np.zeros(1500)]
    lone = np.array([[30.0, 30, 0]])
    found = np.array(page.evaluate(SPACINGS, np.r_[dense, sparse, lone].ravel().tolist()))
    small, large = np.median(found[:6000]), np.median(found[6000:7500])
    assert small == pytest.approx(1 / np.sqrt(6000), rel=0.35)
    assert large == pytest.approx(1 / np.sqrt(1500), rel=0.35)
    assert found[-1] <= 2 * np.median(found) * 1.001  # no large disc


def test_a_scan_of_a_depth_camera_is_seen_and_bright(running: Service, make_page: MakePage, tmp_path: Path) -> None:
    points, _ = _depth_frame()
    random = np.random.default_rng(0)
    write(tmp_path / "frame.ply", PointCloud(points=(points + 0.003 * random.normal(size=points.shape))))
    job = running.wait_status(running.submit(tmp_path / "frame.ply")["id"], "succeeded")
    page = make_page(base(running), dark=True)
    page.goto(f"/#/jobs/{job['id']}")
    wait_state(page, "result")
    assert page.locator("#up").inner_text().startswith("−Y")
    picture = canvas(page)
    assert share_drawn(picture) > 0.25
    drawn = np.abs(picture - picture[-1, 0]).max(axis=2) > 12
    assert np.median(picture[drawn].max(axis=1)) > 110
    rows, columns = np.nonzero(drawn)
    height, width = drawn.shape
    assert (columns.min() + columns.max()) / 2 / width == pytest.approx(0.5, abs=0.03)
    assert ((rows.min() + rows.max()) / 2 - 56) / (height - 56) == pytest.approx(0.5, abs=0.03)  # below the bar
    assert max(np.ptp(columns) / width, np.ptp(rows) / (height - 56)) > 0.8


@pytest.mark.parametrize("size", [(1440, 900), PHONE])
def test_side_by_side_fits(running: Service, make_page: MakePage, done: dict[str, Any], size: tuple[int, int]) -> None:
    page = make_page(base(running), size=size)
    page.goto(f"/#/jobs/{done['id']}")
    wait_state(page, "result")
    split = canvas(page)
    page.locator("label:has(input[value=side])").click()
    picture = canvas(page)
    drawn = np.abs(picture - picture[-1, 0]).max(axis=2) > 60
    height, width = drawn.shape
    halves = (
        (drawn[:, : width // 2], drawn[:, width // 2 :])
        if width > height
        else (drawn[: height // 2], drawn[height // 2 :])
    )
    for half in halves:
        assert half.mean() > 0.04
        edges = np.concatenate([half[:, 2], half[:, -4], half[-3]])  # the divider itself is no part of the picture
        assert edges.mean() < 0.02
    choose(page, "split")
    assert share_different(canvas(page), split) < 0.001


def test_a_link_shows_what_was_seen(running: Service, make_page: MakePage, done: dict[str, Any]) -> None:
    page = make_page(base(running))
    page.goto(f"/#/jobs/{done['id']}")
    wait_state(page, "result")
    page.wait_for_timeout(600)
    assert page.url.endswith(f"#/jobs/{done['id']}")  # nothing to say of the usual look
    page.keyboard.press("3")
    page.keyboard.press("Shift+Y")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("+")
    page.keyboard.press("Shift+ArrowUp")
    page.keyboard.press(",")
    page.keyboard.press("]")
    seen = canvas(page)
    for part in ("up=-y", "colour=height", "split=45", "size=2", "camera="):
        assert part in page.url

    other = make_page(base(running))
    other.goto(page.url)
    wait_state(other, "result")
    assert share_different(canvas(other), seen) < 0.01
    expect(other.locator("#scale")).to_have_attribute("data-colouring", "height")
    other.keyboard.press("b")
    other.keyboard.press("a")
    other.wait_for_timeout(400)
    assert "view=flip&shown=before" in other.url
    other.evaluate(f"location.hash = '#/jobs/{done['id']}?view=side&camera=1,2'")  # not a camera: left out
    expect(other.locator("#stage")).to_have_attribute("data-view", "side")
    other.wait_for_timeout(400)
    assert other.url.endswith("?view=side")

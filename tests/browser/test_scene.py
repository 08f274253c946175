"""The picture of the page at ``/``: before and after, colourings, size, and a million points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from service.worker.gltf import DISPLAY_POINTS, write_display
from tests.support.service_process import Service, sphere, write_sphere
from tests.support.viewing import PHONE, MakePage, base, canvas, choose, share_different, share_drawn, wait_state


def test_the_halves_are_before_and_after(running: Service, make_page: MakePage, done: dict[str, Any]) -> None:
    page = make_page(base(running))
    page.goto(f"/#/jobs/{done['id']}")
    wait_state(page, "result")
    split = canvas(page)
    choose(page, "flip")
    after = canvas(page)
    page.click("#flip")
    before = canvas(page)
    assert min(share_drawn(before), share_drawn(after)) > 0.1
    assert share_different(before, after) > 0.02  # the same picture twice: below 0.001
    middle = split.shape[1] // 2
    left, right = np.s_[:, : middle - 2], np.s_[:, middle + 2 :]
    assert share_different(split[left], before[left]) < 0.001
    assert share_different(split[right], after[right]) < 0.001
    # Noise is grain in the light that falls on it.
    rough, smooth = (np.abs(np.diff(picture[:, :, 0].astype(float), axis=1)).mean() for picture in (before, after))
    assert rough > 1.5 * smooth

    choose(page, "split")
    box = page.locator("#stage").bounding_box()
    knob = page.locator("#divider").bounding_box()
    assert box is not None
    assert knob is not None
    page.mouse.move(knob["x"] + 22, knob["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] * 0.75, knob["y"] + 100, steps=4)
    page.mouse.up()
    assert page.locator("#divider").get_attribute("aria-valuenow") == "75"
    moved = canvas(page)
    line = int(box["width"] * 0.75)
    assert share_different(moved[:, : line - 3], before[:, : line - 3]) < 0.001
    assert share_different(moved[:, line + 3 :], after[:, line + 3 :]) < 0.001

    choose(page, "side")
    side = canvas(page)
    assert min(share_drawn(side[:, :middle]), share_drawn(side[:, middle:])) > 0.05
    choose(page, "overlay")
    assert share_different(canvas(page), after) > 0.05


def test_colourings(running: Service, make_page: MakePage, done: dict[str, Any]) -> None:
    page = make_page(base(running))
    page.goto(f"/#/jobs/{done['id']}")
    wait_state(page, "result")
    pictures = {}
    for name in ("shaded", "file", "height", "displacement", "normal"):
        choose(page, name)
        assert page.locator("#scale").get_attribute("data-colouring") == name
        pictures[name] = canvas(page)
        for other in set(pictures) - {name}:
            assert share_different(pictures[name], pictures[other]) > 0.1, (name, other)
    drawn = pictures["file"][np.abs(pictures["file"] - pictures["file"][-1, 0]).max(axis=2) > 60]
    assert (drawn[:, 0] > 2 * drawn[:, 1]).mean() > 0.9  # the file's red, lit
    choose(page, "height")
    low, high = (float(text) for text in page.locator("#scale .ends span").all_inner_texts())
    assert 479 < low < 485
    assert 515 < high < 521
    choose(page, "displacement")
    assert page.locator("#scale .histogram rect").count() == 64
    assert "file's unit" in page.locator("#scale").inner_text()
    upper = float(page.locator("#scale .ends span").last.inner_text())
    mean = float(page.locator("#numbers .part dd").first.inner_text())
    assert 0 < mean < upper


def test_point_size_up_and_fit(running: Service, make_page: MakePage, done: dict[str, Any], tmp_path: Path) -> None:
    page = make_page(base(running))
    page.goto(f"/#/jobs/{done['id']}")
    wait_state(page, "result")
    usual = canvas(page)
    page.locator("#size").fill("-20")
    assert page.locator("#size-value").inner_text() == "0.3 ×"
    assert share_drawn(canvas(page)) < 0.7 * share_drawn(usual)
    page.locator("#size").fill("0")
    page.click("#up")
    assert share_different(canvas(page), usual) > 0.05
    for _ in range(5):  # through all six ends of the axes
        page.click("#up")
    assert share_different(canvas(page), usual) < 0.001
    page.mouse.move(400, 500)
    page.mouse.wheel(0, -600)
    page.mouse.down()
    page.mouse.move(500, 560, steps=3)
    page.mouse.up()
    assert share_different(canvas(page), usual) > 0.1
    page.click("#reset")
    assert share_different(canvas(page), usual) < 0.001
    with page.expect_download() as caught:
        page.click("#picture")
    assert caught.value.suggested_filename == "pebble_split.png"
    caught.value.save_as(tmp_path / "picture.png")
    saved = np.asarray(Image.open(tmp_path / "picture.png").convert("RGB")).astype(np.int16)
    assert share_different(saved, usual) < 0.001


def test_a_million_points(running: Service, make_page: MakePage, tmp_path: Path) -> None:
    job = running.wait_status(running.submit(write_sphere(tmp_path / "large.ply", 500))["id"], "succeeded")
    points = sphere(1_200_000)
    length = np.linalg.norm(points, axis=1, keepdims=True)
    normals = points / length
    target = running.data / "jobs" / job["id"] / "display.glb"
    write_display(target, before=points, after=normals, raw_normals=normals, normals=normals, colour=None)
    page = make_page(base(running), size=(900, 700))
    page.goto(f"/#/jobs/{job['id']}")
    wait_state(page, "result")
    assert "1 200 000" in page.locator("#numbers").inner_text()
    assert "1 000 000 drawn" in page.locator("#numbers").inner_text()
    usual = canvas(page)
    assert int(page.locator("#canvas").get_attribute("data-drawn") or 0) == DISPLAY_POINTS
    assert share_drawn(usual) > 0.2
    choose(page, "displacement")
    choose(page, "flip")
    assert share_different(canvas(page), usual) > 0.1
    for _ in range(10):
        page.keyboard.press("ArrowLeft")
        page.wait_for_timeout(20)
    page.wait_for_function(f"document.getElementById('canvas').dataset.drawn == {DISPLAY_POINTS}")


def test_the_split_follows_a_finger(running: Service, make_page: MakePage, done: dict[str, Any]) -> None:
    page = make_page(base(running), size=PHONE)
    page.goto(f"/#/jobs/{done['id']}")
    wait_state(page, "result")
    usual = canvas(page)
    touch = page.context.new_cdp_session(page)

    def drag(*places: tuple[int, int]) -> None:
        for index, (x, y) in enumerate(places):
            kind = "touchMove" if index else "touchStart"
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y}]})
        touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})

    drag((195, 300), (240, 310), (292, 320))
    assert page.locator("#divider").get_attribute("aria-valuenow") == "75"
    page.evaluate("document.getElementById('divider').dispatchEvent(new MouseEvent('dblclick'))")
    assert share_different(canvas(page), usual) < 0.001
    drag((80, 400), (140, 420), (180, 430))  # beside it, the picture turns
    assert page.locator("#divider").get_attribute("aria-valuenow") == "50"
    assert share_different(canvas(page), usual) > 0.05
    assert page.evaluate("scrollY") == 0

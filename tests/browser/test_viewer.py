"""The page at ``/`` as a person uses it, with the service and its worker."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import expect

from tests.support.service_process import Service, write_sphere
from tests.support.viewing import DESKTOP, PHONE, MakePage, base, canvas, drop, share_different, share_drawn, wait_state

SAMPLE = Path(__file__).parents[2] / "service" / "viewer" / "sample.ply"
RECORD = """() => {
    window.seen = [];
    const note = () => {
        const step = document.querySelector('[aria-current=step]')?.dataset.step;
        seen.push([document.documentElement.dataset.state, step, document.getElementById('busy-text').textContent,
                   document.getElementById('progress').value]);
    };
    new MutationObserver(note).observe(document.documentElement,
        {attributes: true, childList: true, subtree: true, characterData: true});
}"""


def test_from_the_drop_to_the_download(running: Service, make_page: MakePage, tmp_path: Path) -> None:
    page = make_page(base(running))
    page.goto("/")
    assert page.locator("h1:visible").inner_text() == "Send a noisy scan, get back the surface"
    page.evaluate(RECORD)
    drop(page, SAMPLE)
    wait_state(page, "result")
    seen = page.evaluate("seen")
    assert [step for step in ("upload", "queue", "denoise", "show") if step in {row[1] for row in seen}] == [
        "upload", "queue", "denoise", "show"]  # fmt: skip
    shares = [row[3] for row in seen if row[1] == "denoise" and row[2] == "40 000 points"]
    assert shares == sorted(shares)
    assert len(set(shares)) > 2

    job_id = page.url.split("#/jobs/")[1]
    job = running.job(job_id)
    numbers = page.locator("#numbers").inner_text()
    for text in ("40 000", "mean", "median", "95 %", job["execution"]["model"], job["execution"]["device"]):
        assert text in numbers
    split = canvas(page)
    assert share_drawn(split) > 0.15

    assert page.locator("#format").input_value() == "ply"
    for format_ in ("ply", "npz", "pcd"):
        page.select_option("#format", format_)
        with page.expect_download() as caught:
            page.click("#download")
        saved = tmp_path / format_
        caught.value.save_as(saved)
        expected = running.client.get(job["links"]["result"], params={"format": format_}).content
        assert hashlib.sha256(saved.read_bytes()).digest() == hashlib.sha256(expected).digest()
        assert caught.value.suggested_filename == f"sample_denoised.{format_}"

    page.reload()
    wait_state(page, "result")
    assert share_different(canvas(page), split) < 0.001
    page.go_back()
    wait_state(page, "empty")
    page.go_forward()
    wait_state(page, "result")


def test_a_broken_file_shows_detail_and_hint(running: Service, make_page: MakePage, tmp_path: Path) -> None:
    broken = tmp_path / "broken.ply"
    broken.write_bytes(SAMPLE.read_bytes()[:5000])
    told = running.client.post("/denoise", files={"file": ("broken.ply", broken.read_bytes())}).json()
    page = make_page(base(running), expected="422")
    page.goto("/")
    drop(page, broken)
    wait_state(page, "problem")
    for part in ("title", "detail", "hint", "code"):
        assert page.locator(f"#problem-{part}").inner_text() == told[part]
    expect(page.locator("#problem-title")).to_be_focused()
    with page.expect_file_chooser() as chooser:
        page.click("#problem-pick")
    good = write_sphere(tmp_path / "good.ply", 500)
    chooser.value.set_files(good)
    wait_state(page, "result")
    assert page.locator("#colour-file input").is_disabled()


def test_an_unknown_job(running: Service, make_page: MakePage) -> None:
    page = make_page(base(running), expected="404")
    page.goto("/#/jobs/0123456789abcdef0123456789abcdef")
    wait_state(page, "problem")
    assert page.locator("#problem-code").inner_text() == "job_not_found"
    page.click("#problem-home")
    wait_state(page, "empty")


def test_a_download_that_is_gone_says_why(running: Service, make_page: MakePage, tmp_path: Path) -> None:
    job = running.wait_status(running.submit(write_sphere(tmp_path / "gone.ply", 500))["id"], "succeeded")
    page = make_page(base(running), expected="404")
    page.goto(f"/#/jobs/{job['id']}")
    wait_state(page, "result")
    running.client.delete(f"/jobs/{job['id']}")
    page.click("#download")
    expect(page.locator("#toast")).to_contain_text("You have no job with this id.")


def test_cancel(running: Service, make_page: MakePage, tmp_path: Path) -> None:
    page = make_page(base(running))
    page.goto("/")
    page.set_input_files("#input", write_sphere(tmp_path / "large.npz", 300_000))
    page.locator("[data-step=denoise][aria-current=step]").wait_for()
    page.click("#cancel")
    wait_state(page, "problem")
    assert page.locator("#problem-title").inner_text() == "Cancelled"
    assert running.job(page.url.split("/")[-1])["status"] == "cancelled"


def test_keyboard_alone(running: Service, make_page: MakePage, tmp_path: Path) -> None:
    page = make_page(base(running))
    scan = write_sphere(tmp_path / "typed.ply", 3000)
    page.on("filechooser", lambda chooser: chooser.set_files(scan))
    page.goto("/")
    for _ in range(12):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.id") == "pick":
            break
    page.keyboard.press("Enter")
    wait_state(page, "result")
    stage = page.locator("#stage")
    first = canvas(page)
    for key, attribute, value in (("a", "shown", "before"), ("b", "shown", "after"), (" ", "shown", "before"),
                                  ("d", "view", "side"), ("o", "view", "overlay"), ("s", "view", "split")):  # fmt: skip
        page.keyboard.press("Space" if key == " " else key)
        expect(stage).to_have_attribute(f"data-{attribute}", value)
    for key, name in (("3", "height"), ("4", "displacement"), ("5", "normal"), ("2", "normal"), ("1", "shaded")):
        page.keyboard.press(key)
        expect(page.locator("#scale")).to_have_attribute("data-colouring", name)
    page.keyboard.press(",")
    expect(page.locator("#divider")).to_have_attribute("aria-valuenow", "45")
    page.keyboard.press(".")
    page.keyboard.press("]")
    expect(page.locator("#size-value")).to_have_text("1.1 ×")
    page.keyboard.press("[")
    for keys in (["ArrowLeft", "ArrowUp"], ["Shift+ArrowRight"], ["+"], ["y"]):
        for key in keys:
            page.keyboard.press(key)
        assert share_different(canvas(page), first) > 0.004, keys  # a smooth ball looks alike from all sides
        page.keyboard.press("z")
        page.keyboard.press("r")
        assert share_different(canvas(page), first) < 0.001, keys
    page.keyboard.press("?")
    expect(page.locator("#keys-dialog")).to_be_visible()
    assert page.locator("#keys-list div").count() > 15
    page.keyboard.press("Escape")
    expect(page.locator("#keys-dialog")).to_be_hidden()

    reached = []
    page.evaluate("document.activeElement.blur()")
    for _ in range(30):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("document.activeElement.id || document.activeElement.value"))
        if reached[-1] == "divider":
            assert page.evaluate("getComputedStyle(document.activeElement.firstElementChild).outlineStyle") == "solid"
            page.keyboard.press("Shift+ArrowRight")
            expect(page.locator("#divider")).to_have_attribute("aria-valuenow", "60")
        if reached[-1] == "size":
            break
    for expected in (
        "another",
        "theme",
        "canvas",
        "split",
        "divider",
        "reset",
        "picture",
        "download",
        "shaded",
        "size",
    ):
        assert expected in reached
    assert reached.index("canvas") < reached.index("divider") < reached.index("download") < reached.index("size")
    page.keyboard.press("n")
    wait_state(page, "empty")


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_layout(running: Service, make_page: MakePage, done: dict[str, Any], size: tuple[int, int], dark: bool) -> None:
    page = make_page(base(running), size=size, dark=dark)
    processor = page.context.new_cdp_session(page)
    processor.send("Emulation.setCPUThrottlingRate", {"rate": 12})  # so slow that half a page would be painted
    page.add_init_script(
        "window.shift = 0; new PerformanceObserver((list) => list.getEntries().forEach(e => {"
        " if (!e.hadRecentInput) shift += e.value; })).observe({type: 'layout-shift', buffered: true});"
    )
    for address, name in (("/", "empty"), (f"/#/jobs/{done['id']}", "result")):
        page.goto(address)
        wait_state(page, name)
        page.wait_for_timeout(300)
        processor.send("Emulation.setCPUThrottlingRate", {"rate": 1})
        assert page.evaluate("document.documentElement.scrollWidth") == size[0]
        outside, small = page.evaluate(
            """() => {
                const seen = (selector) => [...document.querySelectorAll(selector)]
                    .filter(e => e.checkVisibility({visibilityProperty: true}))
                    .map(e => [e.outerHTML.slice(0, 80), e.getBoundingClientRect()]);
                return [seen('button, a, label, h1, dd').filter(([, box]) => box.left < 0 || box.right > innerWidth),
                        seen('button').filter(([, box]) => box.height < 32)];
            }"""
        )
        assert outside == []
        assert small == []
    assert page.evaluate("shift") < 0.02
    colour = re.findall(r"\d+", page.evaluate("getComputedStyle(document.body).backgroundColor"))
    assert (int(colour[0]) < 60) == dark
    assert (canvas(page)[-1, 0] < 60).all() == dark
    if size == DESKTOP:  # the button wins over the system, and is remembered
        page.click("#theme")
        assert (canvas(page)[-1, 0] < 60).all() != dark
        page.reload()
        wait_state(page, "result")
        assert (canvas(page)[-1, 0] < 60).all() != dark


def test_reference_of_the_api(running: Service, make_page: MakePage) -> None:
    page = make_page(base(running))
    page.goto("/docs")
    page.locator(".opblock-post").first.wait_for()
    assert "/denoise" in page.locator(".opblock-post").first.inner_text()
    page.locator(".opblock-post button.opblock-summary-control").first.click()
    page.locator(".opblock-body").first.wait_for()

"""The options of a job on the page, running a file again with others, and comparing the results."""

from __future__ import annotations

from pathlib import Path

from playwright.sync_api import Page, expect

from tests.support.service_process import Service, write_sphere
from tests.support.viewing import MakePage, base, canvas, choose, share_different, wait_state

FORM = ("model", "iterations", "radius", "fast", "outliers", "nonfinite", "orient", "format")


def _job_id(page: Page) -> str:
    """Return the job of a page's address."""
    return page.url.split("#/jobs/")[1].split("?")[0]


def test_the_options_are_those_of_the_job(running: Service, make_page: MakePage, tmp_path: Path) -> None:
    page = make_page(base(running))
    page.goto("/")
    page.click("#more summary")
    for name in FORM:
        help_line = page.locator(f"#{page.locator(f'#first-{name}').get_attribute('aria-describedby')}")
        assert len(help_line.inner_text()) > 20
    expect(page.locator("#first-model option[value=pcdnf]")).to_be_attached()
    chosen = {"model": "pcdnf-lite", "iterations": "1", "radius": "share", "fast": "true", "outliers": "drop",
              "nonfinite": "reject", "orient": "true", "format": "npz"}  # fmt: skip
    for name, value in chosen.items():
        page.select_option(f"#first-{name}", value)
    page.locator("#options input[type=number]").fill("6.5")
    page.set_input_files("#input", write_sphere(tmp_path / "scan.ply", 2000))
    wait_state(page, "result")
    parameters = running.job(_job_id(page))["parameters"]
    expected = {"model": "pcdnf-lite", "iterations": 1, "radius": "6.5%", "fast": True, "outliers": "drop",
                "nonfinite": "reject", "orient": True}  # fmt: skip
    assert {name: parameters[name] for name in expected} == expected
    expect(page.locator("#format")).to_have_value("npz")
    with page.expect_download() as caught:
        page.click("#download")
    assert caught.value.suggested_filename == "scan_denoised.npz"


def test_a_radius_needs_its_number(running: Service, make_page: MakePage, tmp_path: Path) -> None:
    page = make_page(base(running), expected="422")
    page.goto("/")
    page.click("#more summary")
    page.select_option("#first-radius", "length")
    number = page.locator("#options input[type=number]")
    number.fill("")
    scan = write_sphere(tmp_path / "scan.ply", 500)
    page.set_input_files("#input", scan)
    expect(number).to_be_focused()
    expect(page.locator("html")).to_have_attribute("data-state", "empty")
    number.fill("-1")
    page.set_input_files("#input", scan)
    expect(page.locator("html")).to_have_attribute("data-state", "empty")


def test_a_file_runs_again_and_the_results_compare(running: Service, make_page: MakePage, tmp_path: Path) -> None:
    scan = write_sphere(tmp_path / "twice.ply", 3000)
    first = running.submit(scan, iterations=1, seed=7)["id"]
    running.wait_status(first, "succeeded")
    page = make_page(base(running))
    page.goto(f"/#/jobs/{first}")
    wait_state(page, "result")
    expect(page.locator("#comparison")).to_be_hidden()
    page.click("#again")
    expect(page.locator("#again-file")).to_contain_text("The page no longer holds twice.ply.")
    expect(page.locator("#again-iterations")).to_have_value("1")
    page.select_option("#again-iterations", "2")
    with page.expect_file_chooser() as chooser:
        page.click("#again-run")
    chooser.value.set_files(scan)
    page.wait_for_url(lambda url: first not in url, timeout=60_000)
    wait_state(page, "result")
    second = _job_id(page)
    parameters = running.job(second)["parameters"]
    assert (parameters["iterations"], parameters["seed"]) == (2, 7)

    usual = canvas(page)
    expect(page.locator("#comparison")).to_be_visible()
    page.select_option("#against", first)
    expect(page.locator("#tag-before")).to_contain_text("1 pass")
    expect(page.locator("#tag-after")).to_have_text("This result")
    picture = canvas(page)
    middle = picture.shape[1] // 2
    assert share_different(picture[:, : middle - 3], usual[:, : middle - 3]) > 0.005
    assert share_different(picture[:, middle + 3 :], usual[:, middle + 3 :]) < 0.001
    choose(page, "displacement")
    expect(page.locator("#displacement")).to_have_text("Difference")
    expect(page.locator("#scale")).to_contain_text("the two results lie apart")
    assert float(page.locator("#scale .ends span").last.inner_text()) > 0
    for view in ("flip", "side", "overlay", "split"):
        choose(page, view)
    page.wait_for_timeout(400)
    assert f"against={first}" in page.url
    seen = canvas(page)

    other = make_page(base(running))
    other.goto(page.url)
    wait_state(other, "result")
    expect(other.locator("#against")).to_have_value(first)
    assert share_different(canvas(other), seen) < 0.002
    other.select_option("#against", "")
    expect(other.locator("#tag-before")).to_have_text("Before")

    page.click("#again")  # this time the page holds the file
    expect(page.locator("#again-file")).to_contain_text("twice.ply is sent again.")
    page.select_option("#again-outliers", "drop")
    page.click("#again-run")
    page.wait_for_url(lambda url: second not in url, timeout=60_000)
    wait_state(page, "result")
    assert running.job(_job_id(page))["parameters"]["outliers"] == "drop"

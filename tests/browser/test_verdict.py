"""What the page says was done, in plain words and in the person's unit."""

from __future__ import annotations

import re
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.support.service_process import Service
from tests.support.viewing import MakePage, base, choose, wait_state

VERDICT = """async ([plan, display, unit]) => {
    const { verdict } = await import('/viewer/verdict.js');
    const { setFileUnit } = await import('/viewer/units.js');
    setFileUnit(unit);
    return verdict({ execution: { plan } }, display);
}"""
MOVES = {"median": 0.0004, "p95": 0.0015}


@pytest.fixture
def page(running: Service, make_page: MakePage) -> Page:
    """The start page."""
    page = make_page(base(running))
    page.goto("/")
    return page


def _said(page: Page, *, noise: float, radii: list[float], shares: dict[str, float], unit: str = "m") -> str:
    plan = {"noise": noise, "spacing": 0.002, "radii": radii}
    display: dict[str, Any] = {"points": 12_000, "displacement": MOVES, "shares": shares}
    return " ".join(page.evaluate(VERDICT, [plan, display, unit]))


def test_usual_noise_in_millimetres(page: Page) -> None:
    said = _said(page, noise=0.0007, radii=[0.013, 0.011], shares={"moved": 0.981, "left": 0.019, "doubtful": 0.0001})
    assert said == (
        "There is moderate noise: about 0.700 mm, less than the 2.00 mm between points. In 2 passes, each point was "
        "fitted to the surface within 13.0 mm and then 11.0 mm of it. Of 12 000 points, 98.1 % were moved: half of all "
        "by less than 0.400 mm, and 95 % by less than 1.50 mm. 1.9 % were left where they were: the points around them "
        "do not show a surface, or they were excluded. Less than 0.1 % were moved doubtfully far, by more than three "
        "times the noise around them. The colouring by displacement shows where."
    )


def test_a_clean_cloud_and_a_noisy_one(page: Page) -> None:
    clean = _said(page, noise=0, radii=[0.013], shares={"moved": 0, "left": 1, "doubtful": 0})
    assert clean.startswith("No noise was found. In one pass,")
    assert clean.endswith("Every point was left where it was.")
    noisy = _said(page, noise=0.003, radii=[0.02], shares={"moved": 1, "left": 0, "doubtful": 0})
    assert "strong noise: about 3.00 mm, more than" in noisy
    assert "All points were moved" in noisy
    assert "left" not in noisy
    assert noisy.endswith("None was moved further than its noise explains.")


def test_units(page: Page) -> None:
    def noise(unit: str, value: float) -> str:
        said = _said(page, noise=value, radii=[0.02], shares={"moved": 1, "left": 0, "doubtful": 0}, unit=unit)
        found = re.search("about (.*?), ", said)
        assert found
        return found[1]

    assert noise("m", 0.00005) == "50.0 µm"
    assert noise("mm", 2500) == "2.50 m"
    assert noise("km", 0.5) == "500 m"
    assert noise("ft", 0.25) == "0.250 ft"
    assert noise("", 0.25) == "0.250"
    said = _said(page, noise=1, radii=[1], shares={"moved": 1, "left": 0, "doubtful": 0}, unit="")
    assert said.endswith("Choose below which that is.")


def test_the_result_says_what_was_done(running: Service, make_page: MakePage, done: dict[str, Any]) -> None:
    page = make_page(base(running))
    page.goto(f"/#/jobs/{done['id']}")
    wait_state(page, "result")
    verdict = page.locator("#verdict")
    plan = running.job(done["id"])["execution"]["plan"]
    assert f"noise: about {plan['noise']:.3g}" in verdict.inner_text()
    assert "In one pass" in verdict.inner_text()
    assert "of 20 000 points" in verdict.inner_text().lower() or "All points were moved" in verdict.inner_text()
    page.select_option("#unit", "mm")
    expect(verdict).to_contain_text("mm")
    expect(verdict).not_to_contain_text("the file's unit")
    expect(page.locator("#numbers .part dd").first).to_contain_text("mm")
    choose(page, "height")
    expect(page.locator("#scale .ends span").first).to_contain_text("mm")
    page.reload()
    wait_state(page, "result")
    expect(page.locator("#unit")).to_have_value("mm")
    expect(verdict).to_contain_text("mm")

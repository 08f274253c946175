"""The page for everyone: on a phone, with long names, with a screen reader, and without the network."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from playwright.sync_api import Page, expect

from service.api.app import create_app
from service.settings import Settings
from tests.support.service_process import Served, Service, sphere, write_sphere
from tests.support.viewing import DESKTOP, PHONE, MakePage, base, wait_state

AXE = Path(__file__).parents[2] / "node_modules" / "axe-core" / "axe.min.js"
NAME = "a-scan-whose-name-never-ends-" + "and_has_no_place_to_break" * 3
CUT_OFF = """() => [...document.querySelectorAll('body *')]
    .filter(e => e.checkVisibility({visibilityProperty: true}))
    .map(e => [e.outerHTML.slice(0, 90), e.getBoundingClientRect()])
    .filter(([, box]) => box.right > innerWidth + 0.5 || box.left < -0.5).map(([text]) => text)"""
GAPS = """() => [...document.querySelectorAll('.panel, .panel *, .card, .card *')]
    .filter(e => e.checkVisibility({visibilityProperty: true}) && e.children.length)
    .filter(e => !e.closest('label, svg, select, dl'))
    .map(e => [e, [...e.children].map(child => child.getBoundingClientRect().bottom)])
    .filter(([e, bottoms]) => e.getBoundingClientRect().bottom - Math.max(...bottoms) > 48)
    .map(([e]) => e.outerHTML.slice(0, 90))"""


@pytest.fixture(scope="module")
def waiting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """A service without a worker: its jobs stay in the queue."""
    with Served(create_app(Settings(data_dir=tmp_path_factory.mktemp("waiting")))) as client:
        yield client


@pytest.fixture(scope="module")
def long_name(running: Service, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A finished job of a file with a long name."""
    path = tmp_path_factory.mktemp("long") / f"{NAME}.xyz"
    np.savetxt(path, sphere(800) * 1e6)
    return running.wait_status(running.submit(path)["id"], "succeeded")


def _serious(page: Page) -> list[str]:
    """Return what axe-core calls serious or critical, with the first element of each."""
    if not AXE.is_file():
        pytest.skip("axe-core is not installed: run `npm install`")
    page.evaluate(AXE.read_text())
    found = page.evaluate("axe.run()")["violations"]
    return [
        f"{each['id']}: {each['help']}: {each['nodes'][0]['html']}"
        for each in found
        if each["impact"] in ("serious", "critical")
    ]


def _check(page: Page) -> None:
    assert page.evaluate("document.documentElement.scrollWidth") <= page.evaluate("innerWidth")
    assert page.evaluate(CUT_OFF) == []
    assert page.evaluate(GAPS) == []


def test_nothing_is_cut_off_on_a_phone(
    running: Service, waiting: httpx.Client, make_page: MakePage, long_name: dict[str, Any], tmp_path: Path
) -> None:
    page = make_page(base(running), size=PHONE, expected="404")
    page.goto("/")
    _check(page)
    page.goto(f"/#/jobs/{long_name['id']}")
    wait_state(page, "result")
    expect(page.locator("#subject")).to_have_text(f"{long_name['upload']['name']}.xyz")
    for colouring in ("shaded", "height", "displacement", "normal"):
        page.locator(f"label:has(input[value={colouring}])").click()
        _check(page)
    page.goto(f"/#/jobs/{'0' * 32}")
    wait_state(page, "problem")
    _check(page)

    page = make_page(str(waiting.base_url), size=PHONE)
    page.goto("/")
    page.set_input_files("#input", write_sphere(tmp_path / f"{NAME}.ply", 500))
    expect(page.locator("#busy-text")).to_have_text("Next in the queue", timeout=60_000)
    _check(page)


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_axe_finds_nothing_serious(
    running: Service, make_page: MakePage, long_name: dict[str, Any], size: tuple[int, int], dark: bool
) -> None:
    page = make_page(base(running), size=size, dark=dark, expected="404")
    for address, state in (("/", "empty"), (f"/#/jobs/{long_name['id']}", "result"), ("/#/jobs/none", "problem")):
        page.goto(address)
        wait_state(page, state)
        assert _serious(page) == []
    if size == DESKTOP:
        page.keyboard.press("?")
        expect(page.locator("#keys-dialog")).to_be_visible()
        assert _serious(page) == []


def test_a_lost_connection_is_said_at_once(waiting: httpx.Client, make_page: MakePage, tmp_path: Path) -> None:
    page = make_page(str(waiting.base_url), expected="ERR_INTERNET_DISCONNECTED")
    page.goto("/")
    page.set_input_files("#input", write_sphere(tmp_path / "scan.ply", 500))
    expect(page.locator("#busy-text")).to_contain_text("in the queue", timeout=60_000)
    expect(page.locator("#busy-lost")).to_be_hidden()
    page.context.set_offline(True)
    expect(page.locator("#toast")).to_contain_text("lost its network connection")
    expect(page.locator("#busy-lost")).to_contain_text("The connection to the service was lost.", timeout=20_000)
    page.context.set_offline(False)
    expect(page.locator("#busy-lost")).to_be_hidden(timeout=20_000)
    expect(page.locator("#busy-text")).to_contain_text("in the queue", timeout=60_000)

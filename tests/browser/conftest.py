"""A real browser on the real page. Needs Chromium (Debian's package, or the path in CHROMIUM) and Playwright."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from pcdnf.formats import PointCloud, write
from tests.support.service_process import Service, sphere
from tests.support.viewing import DESKTOP, PHONE, MakePage

FLAGS = [
    "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-quic", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
]  # fmt: skip


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Headless Chromium; WebGL is computed by the processor. Gone with the module: Playwright holds an event loop."""
    names = (os.environ.get("CHROMIUM", "chromium"), "chromium-browser", "google-chrome")
    found = next((path for name in names if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip("no Chromium: install Debian's package `chromium`, or name one in CHROMIUM")
    flags = FLAGS + (["--no-sandbox"] if os.geteuid() == 0 else [])
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=flags)
        yield browser
        browser.close()


@pytest.fixture
def make_page(browser: Browser) -> Iterator[MakePage]:
    """Makes pages that may talk to one service only, and fail the test on any error in their console."""
    contexts, errors = [], []

    def make(base: str, *, size: tuple[int, int] = DESKTOP, dark: bool = False, expected: str = "\0") -> Page:
        context = browser.new_context(
            base_url=base,
            viewport={"width": size[0], "height": size[1]},
            color_scheme="dark" if dark else "light",
            has_touch=size == PHONE,
            reduced_motion="reduce",
        )
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(60_000)

        def told(text: str) -> None:
            if expected not in text:
                errors.append(text)

        page.on("console", lambda message: told(message.text) if message.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("request", lambda sent: None if sent.url.startswith((base, "blob:")) else errors.append(sent.url))
        return page

    yield make
    cookies = [cookie for context in contexts for cookie in context.cookies()]
    for context in contexts:
        context.close()
    assert errors == []
    assert cookies == []


@pytest.fixture(scope="module")
def done(running: Service, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A finished job of a coloured, flattened sphere."""
    noise = 0.8 * np.random.default_rng(1).normal(size=(20_000, 3))
    points = (sphere(20_000) * [40, 30, 20] + noise + [1000, 0, 500]).astype(np.float32)
    colour = {"red": np.full(len(points), 200, np.uint8), "green": np.full(len(points), 30, np.uint8),
              "blue": np.where(points[:, 0] > 1000, 255, 0).astype(np.uint8)}  # fmt: skip
    path = tmp_path_factory.mktemp("clouds") / "pebble.ply"
    write(path, PointCloud(points=points, attributes=colour))
    return running.wait_status(running.submit(path)["id"], "succeeded")

"""What the tests of the page do with it."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Page

from tests.support.service_process import Service

DESKTOP, PHONE = (1440, 900), (390, 844)
MakePage = Callable[..., Page]
Picture = NDArray[np.int16]


def base(service: Service) -> str:
    """Return the address of a service."""
    return str(service.client.base_url)


def state(page: Page) -> Any:
    """Return in which state the page is: empty, busy, result or problem."""
    return page.locator("html").get_attribute("data-state")


def wait_state(page: Page, name: str, seconds: float = 120) -> None:
    """Wait for a state of the page."""
    page.locator(f"html[data-state={name}]").wait_for(state="attached", timeout=seconds * 1000)


def drop(page: Page, path: Path) -> None:
    """Drop a file on the page, as a file manager would."""
    data = page.evaluate_handle(
        """async ([name, bytes]) => {
            const transfer = new DataTransfer();
            transfer.items.add(new File([new Uint8Array(bytes)], name));
            return transfer;
        }""",
        [path.name, list(path.read_bytes())],
    )
    page.dispatch_event("#drop", "dragenter", {"dataTransfer": data})
    assert page.locator("#veil").is_visible()
    page.dispatch_event("#drop", "dragover", {"dataTransfer": data})
    page.dispatch_event("#drop", "drop", {"dataTransfer": data})
    assert page.locator("#veil").is_hidden()


def canvas(page: Page) -> Picture:
    """Return the picture alone (height, width, 3), once it rests."""
    page.wait_for_timeout(600)
    show = "value => document.querySelectorAll('#stage > :not(canvas)').forEach(e => e.style.visibility = value)"
    page.evaluate(show, "hidden")
    box = page.locator("#canvas").bounding_box()
    assert box is not None
    data = page.screenshot(clip=box, timeout=120_000)
    page.evaluate(show, "")
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(np.int16)


def share_drawn(picture: Picture) -> float:
    """Return the share of pixels that are not of the colour behind the points."""
    return float((np.abs(picture - picture[-1, 0]).max(axis=2) > 12).mean())


def share_different(one: Picture, other: Picture) -> float:
    """Return the share of pixels in which two pictures differ."""
    return float((np.abs(one - other).max(axis=2) > 12).mean())


def choose(page: Page, value: str) -> None:
    """Press the button of a view or of a colouring."""
    page.locator(f"label:has(input[value={value}])").click()

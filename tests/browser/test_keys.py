"""The page of a service that asks for a key, without a worker."""

from __future__ import annotations

from pathlib import Path

from playwright.sync_api import expect

from service.api.app import create_app
from service.settings import Settings
from tests.support.service_process import Served, write_sphere
from tests.support.viewing import MakePage, wait_state

KEY = "a key of more than sixteen characters"


def test_the_page_asks_for_the_key_and_keeps_it_in_its_tab(make_page: MakePage, tmp_path: Path) -> None:
    with Served(create_app(Settings(data_dir=tmp_path / "data", api_key=KEY))) as client:
        page = make_page(str(client.base_url), expected="401")
        page.goto("/")
        page.set_input_files("#input", write_sphere(tmp_path / "scan.ply", 500))
        dialog = page.locator("#key-dialog")
        expect(dialog).to_be_visible()
        page.fill("#key", "not the key but long enough")
        page.keyboard.press("Enter")
        expect(page.locator("#key-text")).to_have_text("The service does not know the key that was sent.")
        page.fill("#key", KEY)
        page.keyboard.press("Enter")
        expect(page.locator("#busy-text")).to_have_text("Next in the queue", timeout=60_000)
        kept = "[document.cookie, ...Object.values(localStorage), '|', ...Object.values(sessionStorage)]"
        assert page.evaluate(kept) == ["", "|", KEY]
        page.reload()
        expect(page.locator("#busy-text")).to_have_text("Next in the queue", timeout=60_000)
        expect(dialog).to_be_hidden()
        page.click("#cancel")
        wait_state(page, "problem")
        assert page.locator("#problem-title").inner_text() == "Cancelled"
        (job,) = client.get("/jobs", headers={"Authorization": f"Bearer {KEY}"}).json()
        assert job["status"] == "cancelled"

        other = make_page(str(client.base_url), expected="401")
        other.goto(f"/#/jobs/{job['id']}")
        expect(other.locator("#key-dialog")).to_be_visible()
        other.keyboard.press("Escape")
        wait_state(other, "problem")
        assert other.locator("#problem-code").inner_text() == "not_authenticated"

"""The list of jobs on the page: open, cancel, delete, and older ones."""

from __future__ import annotations

from pathlib import Path

from playwright.sync_api import expect

from service.api.app import create_app
from service.settings import Settings
from tests.support.service_process import Served, Service, write_sphere
from tests.support.viewing import PHONE, MakePage, base, wait_state

AGES = """async (seconds) => {
    const { age } = await import('/viewer/jobs.js');
    return seconds.map(each => age('2026-01-31T12:00:00Z', Date.parse('2026-01-31T12:00:00Z') + each * 1000));
}"""


def test_jobs_are_listed_cancelled_and_deleted(make_page: MakePage, tmp_path: Path) -> None:
    cloud = write_sphere(tmp_path / "scan.ply", 100).read_bytes()
    with Served(create_app(Settings(data_dir=tmp_path / "data"))) as client:
        page = make_page(str(client.base_url), size=PHONE, expected="404")
        page.goto("/")
        page.click("#jobs")
        expect(page.locator("#jobs-none")).to_be_visible()
        page.click("#jobs-close")
        for number in range(21):
            client.post("/denoise", files={"file": (f"scan_{number:02}{'_long' * 20}.ply", cloud)}).raise_for_status()
        page.click("#jobs")
        rows = page.locator("#jobs-list li")
        expect(rows).to_have_count(20)
        expect(rows.first).to_contain_text("scan_20")
        expect(rows.first).to_contain_text("100 points · waiting")
        assert page.evaluate("document.documentElement.scrollWidth") == PHONE[0]
        page.click("#jobs-more")
        expect(rows).to_have_count(21)
        expect(rows.last).to_contain_text("next in the queue")
        expect(page.locator("#jobs-more")).to_be_hidden()

        rows.first.get_by_role("button").click()
        expect(rows.first).to_contain_text("cancelled")
        job = client.get("/jobs").json()[0]
        assert job["status"] == "cancelled"
        delete = rows.first.get_by_role("button")
        delete.click()
        expect(delete).to_have_text("Really?")
        page.locator("#jobs-title").click()  # thought better of it
        expect(delete).to_have_text("Delete")
        assert client.get(f"/jobs/{job['id']}").status_code == 200
        delete.click()
        delete.click()
        expect(rows).to_have_count(20)
        assert client.get(f"/jobs/{job['id']}").status_code == 404

        gone = client.get("/jobs").json()[0]["id"]
        client.post(f"/jobs/{gone}/cancel")
        client.delete(f"/jobs/{gone}")
        rows.first.get_by_role("button").click()
        expect(page.locator("#jobs-said")).to_contain_text("You have no job with this id.")


def test_a_job_opens_from_the_list_and_leaves_when_deleted(
    running: Service, make_page: MakePage, tmp_path: Path
) -> None:
    job = running.wait_status(running.submit(write_sphere(tmp_path / "listed.ply", 500))["id"], "succeeded")
    page = make_page(base(running))
    page.goto("/")
    page.click("#jobs")
    row = page.locator("#jobs-list li", has_text="listed.ply")
    expect(row).to_contain_text("500 points · done")
    row.get_by_role("link").click()
    wait_state(page, "result")
    expect(page.locator("#jobs-dialog")).to_be_hidden()
    page.click("#jobs")
    row.get_by_role("button").click()
    row.get_by_role("button").click()
    wait_state(page, "empty")
    assert running.client.get(f"/jobs/{job['id']}").status_code == 404


def test_ages_in_words(running: Service, make_page: MakePage) -> None:
    page = make_page(base(running))
    page.goto("/")
    assert page.evaluate(AGES, [0, 59, 60, 7200, 86400, 86400 * 9]) == [
        "now", "59 seconds ago", "1 minute ago", "2 hours ago", "yesterday", "9 days ago"]  # fmt: skip

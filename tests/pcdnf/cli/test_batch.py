"""Where the results of several jobs go."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from pcdnf.cli.batch import Destination, Item
from pcdnf.client.schemas import Job, Progress


def job(name: str, format_: str = "ply") -> Job:
    return Job(
        id="0", status="succeeded", progress=Progress(done=1, total=1), created_at=datetime.now(UTC), parameters={},
        upload={"name": name, "format": format_},
    )  # fmt: skip


def placed(destination: Destination, *jobs: Job) -> list[Path]:
    return [destination.of(Item(each.id, job_id=each.id), each)[0] for each in jobs]


def test_two_jobs_of_one_name_have_results_of_their_own(tmp_path: Path) -> None:
    source = tmp_path / "scan.ply"
    destination = Destination(None, tmp_path / "out")
    items = [Item("0", job_id="0"), Item("scan.ply", source)]
    destination.check(items)
    first, second, other = placed(destination, job("scan"), job("scan"), job("scan", "npz"))
    mine, _ = destination.of(items[1], job("scan"))
    assert mine.name == "scan_denoised.ply"
    assert (first.name, second.name, other.name) == (
        "scan_denoised_2.ply",
        "scan_denoised_3.ply",
        "scan_denoised.npz",
    )


def test_no_name_leads_out_of_the_folder(tmp_path: Path) -> None:
    destination = Destination(None, tmp_path / "out")
    destination.check([])
    wild = [job("../../x"), job("..\\y"), job("/etc/z"), job("a\0b"), job("c", "x/../../d"), job("..", ""), job("")]
    for path in placed(destination, *wild):
        assert path.parent == tmp_path / "out"
        path.touch()
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert len(names) == len(wild)
    assert {"x_denoised.ply", "y_denoised.ply", "z_denoised.ply"} < names

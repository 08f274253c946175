"""``pcdnf submit`` and ``pcdnf jobs`` as people and scripts run them."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest

from pcdnf.cli.batch import AHEAD
from pcdnf.cli.main import main
from pcdnf.cli.submit import PARAMETERS
from pcdnf.client import Client
from pcdnf.formats import PointCloud, read, write
from service.api.intake.parameters import Parameters
from tests.support.misbehaving import Proxy, busy
from tests.support.service_process import KEY, Service, sphere, write_sphere

LONG = ["--iterations", "4"]


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def test_parameters_are_those_of_the_service() -> None:
    assert PARAMETERS.keys() == Parameters.model_fields.keys()


def test_several_files_by_name_and_pattern(url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "in").mkdir()
    files = [write_sphere(tmp_path / "in" / f"{n}{suffix}", 400 + n) for n, suffix in enumerate([".ply", ".npz"] * 3)]
    assert len(files) > AHEAD
    out = tmp_path / "new" / "out"
    given = [files[0], tmp_path / "in" / "*.npz", tmp_path / "in" / "[0-4].ply"]
    assert run("submit", *given, "--out-folder", out, "--url", url, "--iterations", 1, "--seed", 5) == 0
    captured = capsys.readouterr()
    assert sorted(path.name for path in out.iterdir()) == [f"{file.stem}_denoised{file.suffix}" for file in files]
    assert len(captured.out.splitlines()) == len(files)
    assert re.search(rf"^0\.ply: 400 points in .* s, pcdnf-lite on cpu: {out}/0_denoised\.ply$", captured.out, re.M)
    assert "pcdnf: 0.ply: uploading" in captured.err
    for n, file in enumerate(files):
        after = read(out / f"{file.stem}_denoised{file.suffix}")
        assert len(after) == 400 + n
        assert (after.metadata["seed"], after.metadata["iterations"]) == ("5", "1")


def test_one_bad_file_does_not_stop_the_others(url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.ply").write_bytes(b"ply\nformat ascii 1.0\nend_header\n")
    good = write_sphere(tmp_path / "good.ply", 500)
    out = tmp_path / "out"
    assert run("submit", tmp_path / "bad.ply", good, "--out-folder", out, "--url", url, "--json", "--quiet") == 1
    captured = capsys.readouterr()
    bad, done = (json.loads(line) for line in captured.out.splitlines())
    assert (bad["state"], bad["job"], bad["output"]) == ("failed", None, None)
    assert bad["error"]["code"]
    assert bad["error"]["detail"] in captured.err
    assert (done["state"], done["points"], done["error"]) == ("done", 500, None)
    assert done["output"] == str(out / "good_denoised.ply")
    assert done["seconds"] > 0
    assert len(read(done["output"])) == 500


def test_the_output_picks_the_format(url: str, cloud: Path, tmp_path: Path) -> None:
    assert run("submit", cloud, "-o", tmp_path / "out.npz", "--url", url, "--iterations", "1", "--quiet") == 0
    assert read(tmp_path / "out.npz").flavour.format == "npz"
    columns = tmp_path / "scan.txt"
    columns.write_text("\n".join(",".join(map(str, row)) for row in sphere(300)))
    assert run("submit", columns, "-o", tmp_path / "out.txt", "--url", url, "--iterations", "1", "--quiet") == 0
    assert (tmp_path / "out.txt").read_text().splitlines()[-1].count(",") >= 5, "as it came"


def test_warnings_are_passed_on(url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points = sphere(300)
    points[7] = float("nan")
    write(tmp_path / "holes.ply", PointCloud(points=points))
    out = tmp_path / "out.ply"
    assert run("submit", tmp_path / "holes.ply", "-o", out, "--url", url, "--nonfinite", "drop", "--quiet") == 0
    assert "left out: 7 (1 row)" in capsys.readouterr().err
    assert len(read(out)) == 299


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing*.ply", "-o", "out.ply"], "There is no file nothing"),
        ([".", "-o", "out.ply"], "'./*.ply'"),
        (["a.ply"], "--out-folder"),
        (["a.ply", "b.ply", "-o", "out.ply"], "one file"),
        (["a.ply", "-o", "no/out.ply"], "folder does not exist"),
        (["a.ply", "-o", "sub"], "is a folder"),
        (["a.ply", "sub/a.ply", "--out-folder", "out"], "would both be written"),
        (["a.ply", "--out-folder", "a.ply/out"], "cannot be created"),
        (["--out-folder", "out"], "No files were given"),
        (["--detach", "--resume", "0"], "cannot be combined"),
        (["a.ply", "-o", "out.ply", "--url", "nowhere"], "http"),
        (["a.ply", "-o", "out.ply", "--key-file", "none"], "cannot be read"),
        (["a.ply", "-o", "out.ply", "--key-file", "empty"], "is empty"),
    ],
)
def test_wrong_usage_sends_nothing(
    arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PCDNF_URL", "http://127.0.0.1:9")
    (tmp_path / "sub").mkdir()
    (tmp_path / "empty").touch()
    for name in ("a.ply", "b.ply", "sub/a.ply"):
        write_sphere(tmp_path / name, 10)
    assert run("submit", *arguments) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.out == ""


def test_no_service_fails_every_file_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pcdnf.client.retries.FIRST_CONTACT_SECONDS", 0.5)
    files = [write_sphere(tmp_path / f"{n}.ply", 10) for n in range(8)]
    began = time.monotonic()
    assert run("submit", *files, "--out-folder", tmp_path, "--url", "http://127.0.0.1:9", "--json") == 1
    assert time.monotonic() - began < 3
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["error"]["code"] for line in lines] == ["unreachable"] * 8


def test_a_busy_service_is_waited_for_aloud(proxy: Proxy, cloud: Path, capsys: pytest.CaptureFixture[str]) -> None:
    proxy.faults = [busy(429, "1")]
    assert run("submit", cloud, "--detach", "--url", proxy.address, "--iterations", "1") == 0
    captured = capsys.readouterr()
    assert "Busy. Retrying in 1 s." in captured.err
    assert re.fullmatch("[0-9a-f]{32}\n", captured.out)


def test_detached_jobs_are_listed_resumed_and_removed(
    url: str, cloud: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("submit", cloud, "--detach", "--url", url, "--iterations", "1") == 0
    job_id = capsys.readouterr().out.strip()
    assert run("jobs", "--url", url, "--limit", 1) == 0
    assert re.match(rf"{job_id}  (queued|running|succeeded) +\d+%  .* 1,500 points  small scan$",
                    capsys.readouterr().out)  # fmt: skip
    assert run("submit", "--resume", job_id, "--out-folder", tmp_path, "--url", url) == 0
    assert len(read(tmp_path / "small scan_denoised.ply")) == 1500
    capsys.readouterr()
    assert run("jobs", "--url", url, "--limit", 1, "--json") == 0
    shown = json.loads(capsys.readouterr().out)
    assert (shown["id"], shown["status"]) == (job_id, "succeeded")
    assert run("jobs", "--url", url, "--cancel", job_id) == 1
    assert "already succeeded and cannot be cancelled" in capsys.readouterr().err, "its result stays"
    assert run("jobs", "--url", url, "--remove", job_id) == 0
    assert capsys.readouterr().out == f"{job_id}  removed\n"
    assert run("jobs", "--url", url, "--remove", job_id) == 1
    assert "no job with this id" in capsys.readouterr().err
    assert run("submit", "--resume", job_id, "--out-folder", tmp_path, "--url", url) == 1


def test_a_key_from_a_file_is_never_shown(
    keyed: Service, tmp_path: Path, cloud: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "key").write_text(f"{KEY}\n")
    address = str(keyed.client.base_url)
    with_key = ["--url", address, "--key-file", tmp_path / "key"]
    assert run("submit", cloud, "--detach", *with_key) == 0
    assert run("jobs", *with_key) == 0
    assert run("submit", cloud, cloud.with_name("small*"), "--detach", "--url", address) == 1
    captured = capsys.readouterr()
    assert "requires an API key" in captured.err
    assert "sesame" not in captured.out + captured.err


# interrupts


def command(url: str, *arguments: object) -> list[str]:
    return [sys.executable, "-m", "pcdnf.cli", "submit", *map(str, arguments), "--url", url]


def status(url: str, job_id: str) -> str:
    return str(httpx.get(f"{url}/jobs/{job_id}", trust_env=False).json()["status"])


def only_new(url: str, before: set[str]) -> str:
    with Client(url) as client:
        (job_id,) = {job.id for job in client.jobs()} - before
    return job_id


def ids(url: str) -> set[str]:
    with Client(url) as client:
        return {job.id for job in client.jobs()}


def test_ctrl_c_without_a_terminal_leaves_the_job_and_says_how_to_go_on(url: str, tmp_path: Path) -> None:
    before = ids(url)
    scan = write_sphere(tmp_path / "scan.ply", 3000)
    process = subprocess.Popen(
        command(url, scan, "-o", tmp_path / "out.ply", "--iterations", "4", "--json"),
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    assert process.stderr is not None
    for line in process.stderr:
        if "queued" in line or "%" in line:
            break
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130
    job_id = only_new(url, before)
    assert f"Continue with: pcdnf submit --resume {job_id} -o {tmp_path / 'out.ply'} --url {url}" in err
    assert json.loads(out)["job"] == job_id
    assert json.loads(out)["state"] in ("queued", "running")
    assert not (tmp_path / "out.ply").exists()
    assert run("submit", "--resume", job_id, "-o", tmp_path / "out.ply", "--url", url, "--quiet") == 0
    assert len(read(tmp_path / "out.ply")) == 3000


@pytest.mark.parametrize(("answer", "ended"), [(b"c\n", True), (b"\n", False), (b"\x03", False)])
def test_ctrl_c_on_a_terminal_asks(url: str, tmp_path: Path, answer: bytes, ended: bool) -> None:
    before = ids(url)
    scan = write_sphere(tmp_path / "scan.ply", 8000)
    terminal, inner = pty.openpty()

    def at_the_terminal() -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.login_tty(inner)

    arguments = command(url, scan, "-o", tmp_path / "out.ply", *LONG)
    with subprocess.Popen(arguments, preexec_fn=at_the_terminal) as process:
        os.close(inner)
        try:
            shown = until(terminal, b"denoise:")
            assert b"scan.ply: upload" in shown
            os.write(terminal, b"\x03")
            question = until(terminal, b"[c/L] ")
            assert b"Cancel job " in question
            os.write(terminal, answer)
            rest = until(terminal, None)
            assert process.wait(30) == 130
        finally:
            process.kill()
            os.close(terminal)
    job_id = only_new(url, before)
    with Client(url) as client:
        if ended:
            assert b"scan.ply: cancelled." in rest
            assert client.wait(job_id).status == "cancelled"
        else:
            assert b"--resume " + job_id.encode() in rest
            assert client.job(job_id).status == "running"
            client.cancel(job_id)
            client.wait(job_id)


def until(terminal: int, word: bytes | None, seconds: float = 90) -> bytes:
    """Read a terminal until a word appears, or the program ends."""
    shown = b""
    deadline = time.monotonic() + seconds
    while word is None or word not in shown:
        ready, _, _ = select.select([terminal], [], [], max(0, deadline - time.monotonic()))
        assert ready, shown
        try:
            data = os.read(terminal, 65536)
        except OSError:  # Linux: the other end is closed
            data = b""
        if not data:
            assert word is None, shown
            return shown
        shown += data
    return shown

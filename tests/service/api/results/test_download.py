from __future__ import annotations

import pytest
from starlette.requests import Request

from pcdnf.file_formats import available
from service.api.results.download import MEDIA_TYPES, _accepted, respond, respond_display
from service.jobs.files import DISPLAY
from service.problems import Problem
from tests.support.board import Board


@pytest.mark.parametrize(
    ("accept", "expected"),
    [
        ("*/*", "own"),
        ("", None),
        ("application/ply", "ply"),
        ("application/x-npz", "npz"),
        ("application/*", "own"),
        ("application/octet-stream", "own"),
        ("text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8", "own"),
        ("application/ply;q=0.2, application/x-npz;q=0.9", "npz"),
        ("application/ply, */*;q=0.5", "ply"),
        ("application/ply;q=0, application/*", "npz"),
        ("application/ply;q=x", None),
        ("text/html", None),
    ],
)
@pytest.mark.parametrize("own", ["ply", "npz"])
def test_accept(accept: str, expected: str | None, own: str) -> None:
    assert _accepted(accept, own) == (own if expected == "own" else expected)


@pytest.mark.parametrize(
    ("accept", "own", "expected"),
    [
        ("text/plain", "ply", "xyz"),
        ("text/plain", "pts", "pts"),
        ("text/csv", "ply", "csv"),
        ("text/*", "csv", "csv"),
        ("text/*", "ply", "xyz"),
        ("application/*", "xyz", "ply"),
        ("application/x-pcd, text/*;q=0.1", "csv", "pcd"),
        ("application/octet-stream", "csv", "csv"),
    ],
)
def test_accept_beyond_ply_and_npz(accept: str, own: str, expected: str) -> None:
    assert _accepted(accept, own) == expected


@pytest.mark.parametrize("method", ["GET", "HEAD"])
def test_files_that_go_while_they_are_asked_for(board: Board, monkeypatch: pytest.MonkeyPatch, method: str) -> None:
    job = board.submit()
    board.attempts.acquire(job.id)
    board.attempts.succeed(job.id, {"ply": {"size": 1, "sha256": "00" * 32}}, [])
    request = Request({"type": "http", "method": method, "headers": []})
    with pytest.raises(Problem) as caught:
        respond(request, board.now(job), board.storage, "ply")
    assert caught.value.code == "job_expired"
    board.path(job, DISPLAY).touch()
    size = board.storage.size

    def last_size(name: str) -> int:
        found = size(name)
        board.path(job, DISPLAY).unlink()
        return found

    monkeypatch.setattr(board.storage, "size", last_size)
    with pytest.raises(Problem) as caught:
        respond_display(request, board.now(job), board.storage)
    assert caught.value.code == "job_expired"


def test_every_format_there_is_has_a_media_type() -> None:
    assert list(MEDIA_TYPES) == available()

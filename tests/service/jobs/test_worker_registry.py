from __future__ import annotations

import threading

import sqlalchemy as sa

from service.database.tables import workers as table
from tests.support.board import Board


def test_signs_of_life(board: Board) -> None:
    board.workers.beat("b", pid=2, state="starting", details={})
    board.workers.beat("a", pid=1, state="starting", details={})
    board.workers.beat("a", pid=1, state="ready", details={"device": "cpu"}, job="j", points_per_second=7.0)
    board.workers.beat("a", pid=1, state="ready", details={"device": "cpu"})
    first, second = board.workers.alive(10)
    assert (first.id, first.state, first.job, first.details, first.points_per_second) == (
        "a", "ready", None, {"device": "cpu"}, 7.0,
    )  # fmt: skip
    assert first.age_seconds < 5
    assert second.id == "b"
    board.workers.leave("b")
    assert [worker.id for worker in board.workers.alive(10)] == ["a"]


def test_silence(board: Board) -> None:
    board.workers.beat("a", pid=1, state="ready", details={})
    with board.engine.begin() as connection:
        connection.execute(table.update().values(beat_at=sa.literal(1)))
    assert board.workers.alive(10) == []
    board.workers.forget(10)
    with board.engine.connect() as connection:
        assert connection.execute(sa.select(table)).all() == []


def test_another_under_the_same_name(board: Board) -> None:
    def listen() -> bool:
        return board.workers.beats_elsewhere("a", 0.3)

    def beat() -> None:
        board.workers.beat("a", pid=1, state="ready", details={})

    assert not listen()
    beat()
    assert not listen()  # it died: no second beat
    beat()
    later = threading.Timer(0.3, beat)
    later.start()
    assert listen()
    later.join()
    board.workers.leave("a")
    assert not listen()

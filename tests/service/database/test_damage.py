"""A damaged database or data folder is named, with its code and what to do, wherever one meets it."""

from __future__ import annotations

import random
import shutil
import sqlite3
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from service.database.damage import ADVICE, SENTENCES, DamageError, check_data, check_file, damage_of
from service.database.engine import create_engine
from service.database.tables import jobs as jobs_table
from service.operations.doctor import CHECKS
from service.operations.drain import drain
from service.settings import Settings
from service.startup import make_data_dir, upgrade_database
from tests.support.board import Board
from tests.support.service_process import Served

PAGE_BYTES = 4096


def closed(board: Board) -> Path:
    """The database of a board with a job, all of it in one file."""
    board.submit()
    board.jobs.close()
    board.engine.dispose()
    path = board.settings.data_dir / "pcdnf.sqlite"
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    connection.close()
    return path


def spoil(path: Path, page: int) -> None:
    """Overwrite a page of a database."""
    with path.open("r+b") as file:
        file.seek(page * PAGE_BYTES)
        file.write(random.Random(page).randbytes(PAGE_BYTES))


def code_of(settings: Settings) -> str | None:
    try:
        check_file(settings, thorough=True)
    except DamageError as error:
        return error.code
    return None


def test_each_page_in_turn(board: Board, tmp_path: Path) -> None:
    whole = closed(board)
    pages = whole.stat().st_size // PAGE_BYTES
    assert pages > 20
    settings = Settings(data_dir=tmp_path / "copy")
    settings.data_dir.mkdir()
    copy = settings.data_dir / "pcdnf.sqlite"
    found, met = [], []
    for page in range(pages):
        for other in settings.data_dir.iterdir():
            other.unlink()
        shutil.copy(whole, copy)
        spoil(copy, page)
        found.append(code_of(settings))
        engine = create_engine(settings)
        try:
            with engine.begin() as connection:
                connection.execute(sa.select(jobs_table)).all()
                connection.execute(jobs_table.update().values(status="failed"))
        except SQLAlchemyError as error:
            met.append(damage_of(error))
        finally:
            engine.dispose()
    assert found == ["database_corrupt"] * pages
    assert set(met) == {"database_corrupt"}


def test_a_whole_database_and_none_are_no_damage(board: Board, tmp_path: Path) -> None:
    check_data(board.settings, thorough=True)
    (tmp_path / "fresh").mkdir()
    check_data(Settings(data_dir=tmp_path / "fresh"), thorough=True)
    (tmp_path / "fresh" / "pcdnf.sqlite").touch()
    check_data(Settings(data_dir=tmp_path / "fresh"), thorough=True)
    assert [path.name for path in (tmp_path / "fresh").iterdir()] == ["pcdnf.sqlite"]


@pytest.fixture(params=["corrupt", "no database", "foreign", "read-only"])
def damaged(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Settings, str]:
    """Settings with a damaged folder, and the code of the damage."""
    path = tmp_path / "data" / "pcdnf.sqlite"
    path.parent.mkdir()
    if request.param == "corrupt":
        upgrade_database(Settings(data_dir=path.parent))
        with sqlite3.connect(path) as connection:
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        connection.close()
        for page in range(2, path.stat().st_size // PAGE_BYTES):
            spoil(path, page)
        return Settings(data_dir=path.parent), "database_corrupt"
    if request.param == "no database":
        path.write_text("these are my notes\n" * 500)
        return Settings(data_dir=path.parent), "database_corrupt"
    if request.param == "foreign":
        with sqlite3.connect(path) as connection:
            connection.execute("CREATE TABLE songs (title TEXT)")
        connection.close()
        return Settings(data_dir=path.parent), "foreign_database"
    return Settings(data_dir=Path("/proc/self")), "data_read_only"


def test_serve_refuses_in_one_line(damaged: tuple[Settings, str], capsys: pytest.CaptureFixture[str]) -> None:
    settings, code = damaged
    with pytest.raises(SystemExit) as ended:
        make_data_dir(settings, thorough=True)
    assert ended.value.code == 78
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"pcdnf: {SENTENCES[code].removesuffix('.')}: {settings.data_dir}")
    assert line.endswith(f"({code})")
    assert ADVICE[code].partition(" ")[0] in line


def test_doctor_says_so(damaged: tuple[Settings, str]) -> None:
    settings, code = damaged
    checks = [check for check in CHECKS if check.__name__ in ("_data_folder", "_database")]
    (problem,) = [finding for check in checks for finding in check(settings) if finding.level == "problem"]
    assert problem.code == code
    assert problem.advice


def test_drain_says_so(damaged: tuple[Settings, str]) -> None:
    settings, code = damaged
    if code == "data_read_only":
        pytest.skip("it asks for a database first")
    with pytest.raises(DamageError) as caught:
        drain(settings, on=None, wait=False)
    assert caught.value.code == code


def test_a_running_api_says_so(make_served: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    served: Served = make_served()
    path = tmp_path / "data" / "pcdnf.sqlite"
    served.app.state.engine.dispose()
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    connection.close()
    for page in range(1, path.stat().st_size // PAGE_BYTES):
        spoil(path, page)
    answer = served.client.get("/jobs")
    assert (answer.status_code, answer.json()["code"]) == (503, "database_corrupt")
    assert str(tmp_path) not in answer.text
    ready = served.client.get("/readyz").json()
    assert (ready["code"], ready["damage"]) == ("not_ready", "database_corrupt")
    assert SENTENCES["database_corrupt"] in ready["detail"]
    assert "pcdnf doctor" in ready["hint"]
    assert not [record for record in caplog.records if record.exc_info]


def test_errors_by_their_kind(tmp_path: Path) -> None:
    engine = create_engine(Settings(data_dir=tmp_path))
    with engine.connect() as connection:
        connection.exec_driver_sql("CREATE TABLE a (b)")
        connection.commit()
        connection.exec_driver_sql("PRAGMA query_only=ON")
        with pytest.raises(SQLAlchemyError) as caught:
            connection.exec_driver_sql("INSERT INTO a VALUES (1)")
        assert damage_of(caught.value) == "data_read_only"
        with pytest.raises(SQLAlchemyError) as caught:
            connection.exec_driver_sql("INSERT INTO nothing VALUES (1)")
        assert damage_of(caught.value) is None
    engine.dispose()
    assert damage_of(PermissionError(13, "no")) == "data_read_only"
    assert damage_of(FileNotFoundError(2, "no")) is None

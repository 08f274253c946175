"""What can be wrong with the data folder and the SQLite file in it, each with a code, a sentence and what to do."""

from __future__ import annotations

import errno
import math
import os
import secrets
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

import sqlalchemy as sa

from ..settings import Settings, SettingsError

OPEN_SECONDS = 4.0
CHECKUP_SECONDS = 60.0  # between two readings of every page; a damaged file is read again each time
_CORRUPT = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
_READ_ONLY = (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM)
_LOCKED = (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)
_REFUSED = (errno.EROFS, errno.EACCES, errno.EPERM)
_OWN_TABLES = {"pcdnf_jobs", "workflow_status", "dbos_migrations"}
SENTENCES = {
    "database_corrupt": "The job database is damaged.",
    "foreign_database": "The job database belongs to another program.",
    "data_read_only": "The data folder cannot be written.",
    "database_locked": "The job database is locked by another program.",
}
"""Code and sentence of each kind of damage."""
ADVICE = {
    "database_corrupt": "Stop the service and keep a copy of the data folder. Then restore a backup of the file, or "
    "rescue what can be read with `sqlite3 FILE .recover | sqlite3 NEW_FILE`.",
    "foreign_database": "Set PCDNF_DATA_DIR or --data-dir to a folder of this service alone.",
    "data_read_only": "Make it writable for the user of the service, or set PCDNF_DATA_DIR or --data-dir to another "
    "folder.",
    "database_locked": "Close the program that has the file open, such as a database browser or a backup.",
}
"""What the operator can do about it."""


class DamageError(SettingsError):
    """Damage that the service cannot run with.

    Parameters
    ----------
    code : str
        A key of :data:`SENTENCES`.
    where : str
        The file or folder.
    """

    def __init__(self, code: str, where: object) -> None:
        self.code, self.where = code, str(where)
        self.sentence = f"{SENTENCES[code].removesuffix('.')}: {where}."
        self.advice = ADVICE[code].replace("FILE", str(where)) if code == "database_corrupt" else ADVICE[code]
        super().__init__(f"{self.sentence} {self.advice} ({code})")


def damage_of(error: BaseException) -> str | None:
    """Return the code of the damage behind an error of SQLAlchemy, SQLite or the file system; None for others."""
    cause = getattr(error, "orig", None) or error
    number = getattr(cause, "sqlite_errorcode", None)
    if number is not None:
        kinds = {"database_corrupt": _CORRUPT, "data_read_only": _READ_ONLY, "database_locked": _LOCKED}
        return next((code for code, numbers in kinds.items() if number & 0xFF in numbers), None)
    if isinstance(cause, OSError) and cause.errno in _REFUSED:
        return "data_read_only"
    return None


def check_data(settings: Settings, *, thorough: bool) -> None:
    """Check that the data folder can be written and that its database is ours and whole; nothing is changed.

    Parameters
    ----------
    settings : Settings
    thorough : bool
        Whether every page of the database is read (``PRAGMA quick_check``).

    Raises
    ------
    DamageError
    """
    _check_writable(settings.data_dir)
    check_file(settings, thorough=thorough)


def check_file(settings: Settings, *, thorough: bool) -> None:
    """Check that the SQLite file of the settings, if there is one, is ours and whole.

    Raises
    ------
    DamageError
    """
    path = database_file(settings)
    if path is None or not path.exists() or path.stat().st_size == 0:
        return
    try:
        with closing(sqlite3.connect(f"file:{quote(str(path))}?mode=rw", uri=True, timeout=OPEN_SECONDS)) as connection:
            tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if tables and not tables & _OWN_TABLES:
                raise DamageError("foreign_database", path)
            if thorough and next(_complaints(connection), None) is not None:
                raise DamageError("database_corrupt", path)
    except sqlite3.Error as error:
        code = damage_of(error) or "database_corrupt"
        if code != "database_locked":  # it passes
            raise DamageError(code, path) from error


class Checkup:
    """The check of a running service: whether the folder can be written, and from time to time every page.

    Parameters
    ----------
    settings : Settings
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._read_at = -math.inf

    def damage(self) -> str | None:
        """Return the code of what is wrong, or None."""
        thorough = time.monotonic() - self._read_at > CHECKUP_SECONDS
        try:
            check_data(self._settings, thorough=thorough)
        except DamageError as error:
            return error.code
        if thorough:
            self._read_at = time.monotonic()
        return None


def database_file(settings: Settings) -> Path | None:
    """Return the SQLite file of the settings; None for a database server."""
    url = sa.make_url(settings.resolved_database_url)
    return Path(str(url.database)) if url.get_backend_name() == "sqlite" else None


def _complaints(connection: sqlite3.Connection) -> Iterator[str]:
    return (text for (text,) in connection.execute("PRAGMA quick_check(1)") if text != "ok")


def _check_writable(folder: Path) -> None:
    probe = folder / f".{secrets.token_hex(8)}"
    try:
        os.close(os.open(probe, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
        probe.unlink()
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            return  # a full disk passes
        raise DamageError("data_read_only", folder) from error

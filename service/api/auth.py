"""Authentication by named keys. Keys are stored as hashes and compared in constant time."""

from __future__ import annotations

import hashlib
import hmac
import logging
import os
import re
import threading
from pathlib import Path
from typing import Annotated

from fastapi import Request, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from ..problems import Problem
from ..settings import Settings, SettingsError
from .rate_limit import Rates

log = logging.getLogger(__name__)

ANONYMOUS = "anonymous"
_LINE = re.compile(r"^([A-Za-z0-9._-]{1,64}):([0-9a-fA-F]{64})$")


class Keys:
    """The keys in force: one from the settings, and those of a file that is read again when it changes.

    Parameters
    ----------
    api_key : str or None
        A single key in plain text, known as ``default``.
    path : Path or None
        A file of lines ``name:sha256-hex``.

    Raises
    ------
    SettingsError
        If the file cannot be read or a line of it is malformed, when first read.
    """

    def __init__(self, api_key: str | None, path: Path | None) -> None:
        self._fixed = {} if api_key is None else {hashlib.sha256(api_key.encode()).digest(): "default"}
        self._path = path
        self._version: tuple[int, int] | None = None
        self._reported: tuple[int, ...] | None = ()  # the version whose fault is in the log
        self._named: dict[bytes, str] = {}
        self._lock = threading.Lock()
        self._refresh()

    @classmethod
    def of(cls, settings: Settings) -> Keys:
        """Return the keys that `settings` name."""
        return cls(settings.api_key, settings.api_keys_file)

    @property
    def required(self) -> bool:
        """Whether callers need a key."""
        return bool(self._fixed) or self._path is not None

    @property
    def count(self) -> int:
        """How many keys are in force."""
        return len(self._fixed | self._named)

    def owner(self, key: str) -> str | None:
        """Return the name of `key`, or None; every stored key is compared, in constant time."""
        self._refresh()
        digest = hashlib.sha256(key.encode("utf-8", "surrogateescape")).digest()
        found = None
        for stored, name in (self._fixed | self._named).items():
            if hmac.compare_digest(stored, digest):
                found = name
        return found

    def _refresh(self) -> None:
        if self._path is None:
            return
        with self._lock:
            version = None
            try:
                stat = os.stat(self._path)
                version = (stat.st_mtime_ns, stat.st_ino)
                if version != self._version:
                    self._named = _parse(self._path)
                    self._version = version
            except (OSError, SettingsError) as error:
                # At start it is the operator's error; later the keys last read stay in force.
                if self._version is None:
                    raise SettingsError(f"The file in PCDNF_API_KEYS_FILE cannot be used: {error}") from error
                if version != self._reported:
                    self._reported = version
                    log.warning("the file of keys cannot be used, the keys read last stay valid: %s", error)


def _parse(path: Path) -> dict[bytes, str]:
    keys = {}
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise SettingsError("it is not UTF-8 text") from None
    for number, line in enumerate(text.splitlines(), 1):
        content = line.partition("#")[0].strip()
        if not content:
            continue
        match = _LINE.match(content)
        if match is None:
            raise SettingsError(f"line {number} is not `name:sha256-in-hex`")
        keys[bytes.fromhex(match[2])] = match[1]
    return keys


_bearer = HTTPBearer(auto_error=False, description="Required if the service has keys")


def caller(request: Request, credentials: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)]) -> str:
    """Return the name of the caller of `request`; a dependency of every route that needs one.

    Raises
    ------
    Problem
        401 where keys are in force and none of them was sent, 429 for too many requests.
    """
    keys: Keys = request.app.state.keys
    rates: Rates = request.app.state.rates
    if not keys.required:
        rates.take(ANONYMOUS)
        return ANONYMOUS
    owner = None if credentials is None else keys.owner(credentials.credentials)
    if owner is None:
        raise Problem(
            "not_authenticated",
            "This service requires an API key, and the request has none or an unknown one.",
            hint="Send the header `Authorization: Bearer <key>`.",
            headers={"WWW-Authenticate": "Bearer"},
        )
    rates.take(owner)
    return owner

"""``Idempotency-Key``: a repeated request creates no second job.

A key is claimed before the body is read, with a lease that is renewed during the upload. If the API process crashes,
the lease runs out within seconds and the key is free again. The key is bound to the job in the transaction that
accepts it, and is removed together with the job.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import logging
import re
import secrets
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from fastapi import Request
from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from ...database.engine import exclusive
from ...database.tables import idempotency as table
from ...database.tables import now_ms
from ...problems import Problem

log = logging.getLogger(__name__)

HEADER = "Idempotency-Key"
LONGEST_KEY = 255
LEASE_SECONDS = 15.0
RENEW_SECONDS = 5.0
_KEY = re.compile(rf'"?([\x21\x23-\x7e]{{1,{LONGEST_KEY}}})"?', re.ASCII)


def idempotency_key(request: Request) -> str | None:
    """Return the key of a request, without the quotes that the draft of the IETF puts around it.

    Raises
    ------
    Problem
        400 if the header is not a valid key.
    """
    given = request.headers.getlist(HEADER)
    if not given:
        return None
    match = _KEY.fullmatch(given[0].strip())
    if len(given) > 1 or match is None:
        raise Problem(
            "bad_request",
            f"The header {HEADER} must be a single value of 1 to {LONGEST_KEY} visible ASCII characters.",
            hint="Send a new UUID for each job, and the same UUID when you repeat the request.",
        )
    return match[1]


def fingerprint(sha256: str, name: str, parameters: dict[str, Any]) -> str:
    """Return a hash of what distinguishes requests: the file's hash, its name and the parameters."""
    return hashlib.sha256(json.dumps([sha256, name, parameters], sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Claim:
    """The claim on a caller's key: held for this request, or bound to the job of an earlier one."""

    owner: str
    key: str
    token: str
    job: str | None = None
    fingerprint: str | None = None

    def check(self, fingerprint: str) -> None:
        """Raise 422 where the key was used for another request."""
        if self.fingerprint != fingerprint:
            raise Problem(
                "idempotency_key_reused",
                f"This {HEADER} was already used with another file, file name or set of parameters.",
                hint="Send a new key for a new job.",
            )


class Claims:
    """The table of keys.

    Parameters
    ----------
    engine : sqlalchemy.Engine
    """

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def claim(self, owner: str, key: str) -> Claim:
        """Return the caller's claim on `key`, with the job of an earlier request if there was one.

        Raises
        ------
        Problem
            409 while another request holds the key.
        """
        fresh = Claim(owner, key, secrets.token_hex(16))
        mine = (table.c.owner == owner) & (table.c.key == key)
        lease: Any = now_ms() + int(LEASE_SECONDS * 1000)
        with self._engine.connect() as connection, exclusive(connection):
            query = sa.select(table, (table.c.lease_until > now_ms()).label("held")).where(mine)
            row = connection.execute(query).mappings().one_or_none()
            if row is None:
                values = {"owner": owner, "key": key, "token": fresh.token, "lease_until": lease}
                connection.execute(table.insert().values(values))
            elif row["job"] is not None:
                return Claim(owner, key, row["token"], row["job"], row["fingerprint"])
            elif row["held"]:
                raise Problem(
                    "idempotency_key_in_use",
                    f"Another request with this {HEADER} is still uploading.",
                    hint="Wait for its response, or repeat this request after the number of seconds in Retry-After.",
                    headers={"Retry-After": "2"},
                )
            else:
                connection.execute(table.update().where(mine).values(token=fresh.token, lease_until=lease))
        return fresh

    def renew(self, claim: Claim) -> None:
        """Hold the key for another while."""
        lease: Any = now_ms() + int(LEASE_SECONDS * 1000)
        with self._engine.begin() as connection:
            connection.execute(table.update().where(_unbound(claim)).values(lease_until=lease))

    def release(self, claim: Claim) -> None:
        """Release the key, unless it was bound to a job."""
        with self._engine.begin() as connection:
            connection.execute(table.delete().where(_unbound(claim)))

    @staticmethod
    def bind(connection: sa.Connection, claim: Claim, job_id: str, fingerprint: str) -> None:
        """Bind the key to its job, in the transaction that accepts the job.

        Raises
        ------
        Problem
            409 where the lease ran out and another request took the key.
        """
        values = {"job": job_id, "fingerprint": fingerprint, "lease_until": None}
        if connection.execute(table.update().where(_unbound(claim)).values(values)).rowcount != 1:
            raise Problem(
                "idempotency_key_in_use",
                f"Another request with this {HEADER} was faster.",
                hint="Send this request again after the number of seconds in Retry-After.",
                headers={"Retry-After": "2"},
            )

    @asynccontextmanager
    async def held(self, owner: str, key: str | None) -> AsyncIterator[Claim | None]:
        """Hold a key during a request; None if the request has none.

        Raises
        ------
        Problem
            See :meth:`claim`.
        """
        if key is None:
            yield None
            return
        claim = await run_in_threadpool(self.claim, owner, key)
        if claim.job is not None:
            yield claim
            return
        renewing = asyncio.create_task(self._keep(claim))
        try:
            yield claim
        finally:
            renewing.cancel()
            await run_in_threadpool(self.release, claim)

    async def _keep(self, claim: Claim) -> None:
        while True:
            await asyncio.sleep(RENEW_SECONDS)
            try:
                await run_in_threadpool(self.renew, claim)
            except SQLAlchemyError:
                log.exception("an idempotency key could not be held")


def _unbound(claim: Claim) -> sa.ColumnElement[bool]:
    named = (table.c.owner == claim.owner) & (table.c.key == claim.key)
    return named & (table.c.token == claim.token) & table.c.job.is_(None)

"""The drain switch. An operator sets it for all processes, and it stays on until it is turned off.

A draining service finishes the jobs it has, refuses new ones, and answers all other requests.
"""

from __future__ import annotations

import sqlalchemy as sa

from ..database.tables import now_ms
from ..database.tables import switches as table
from ..problems import Problem

DRAIN = "drain"
RETRY_SECONDS = 60
_TURN_ON = sa.text("INSERT INTO pcdnf_switches (name, since) VALUES (:name, :since) ON CONFLICT (name) DO NOTHING")


def is_on(connection: sa.Connection, name: str) -> bool:
    """Return whether a switch is on."""
    return connection.execute(sa.select(table.c.name).where(table.c.name == name)).scalar() is not None


def set_switch(connection: sa.Connection, name: str, *, on: bool) -> None:
    """Turn a switch; one that is so already stays so."""
    if on:
        since = connection.execute(sa.select(now_ms())).scalar_one()
        connection.execute(_TURN_ON, {"name": name, "since": since})
    else:
        connection.execute(table.delete().where(table.c.name == name))


def check_open(connection: sa.Connection) -> None:
    """Refuse a new job while the service is drained.

    Raises
    ------
    Problem
        503 ``draining``.
    """
    if is_on(connection, DRAIN):
        raise Problem(
            "draining",
            "The service is draining: it finishes the jobs it has and takes no new ones.",
            hint="Send the file again after the number of seconds in Retry-After.",
            headers={"Retry-After": str(RETRY_SECONDS)},
        )

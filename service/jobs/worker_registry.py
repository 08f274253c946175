"""The table of workers: which ones are alive, on what device, at what speed."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from ..database.tables import now_ms
from ..database.tables import workers as table


@dataclass(frozen=True)
class Worker:
    """A worker as it last reported."""

    id: str
    pid: int
    state: str  # "starting", "ready" or "stopping"
    job: str | None
    details: dict[str, Any]
    points_per_second: float | None
    age_seconds: float
    metrics: str | None


class Workers:
    """Heartbeats, by the clock of the database.

    Parameters
    ----------
    engine : sqlalchemy.Engine
    """

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def beat(
        self,
        worker_id: str,
        *,
        pid: int,
        state: str,
        details: dict[str, Any],
        job: str | None = None,
        points_per_second: float | None = None,
        metrics: str | None = None,
    ) -> None:
        """Record that `worker_id` is alive. A speed of None leaves the last one in place."""
        values = {"pid": pid, "state": state, "details": details, "job": job, "beat_at": now_ms(), "metrics": metrics}
        if points_per_second is not None:
            values["points_per_second"] = points_per_second
        with self._engine.begin() as connection:
            known = connection.execute(table.update().where(table.c.id == worker_id).values(values)).rowcount
            if not known:
                connection.execute(table.insert().values(id=worker_id, **values))

    def beats_elsewhere(self, worker_id: str, heartbeat_seconds: float) -> bool:
        """Return whether another process beats under the name `worker_id`.

        Returns at once if there is no recent heartbeat. Otherwise it waits for a further one.
        """
        listen = 2 * heartbeat_seconds
        first = self._last_beat(worker_id, listen)
        if first is None:
            return False
        time.sleep(listen)
        return self._last_beat(worker_id, listen) not in (first, None)

    def _last_beat(self, worker_id: str, within_seconds: float) -> int | None:
        since = now_ms() - int(within_seconds * 1000)
        query = sa.select(table.c.beat_at).where(table.c.id == worker_id, table.c.beat_at > since)
        with self._engine.connect() as connection:
            return connection.execute(query).scalar()

    def leave(self, worker_id: str) -> None:
        """Record that `worker_id` has stopped."""
        with self._engine.begin() as connection:
            connection.execute(table.delete().where(table.c.id == worker_id))

    def alive(self, within_seconds: float) -> list[Worker]:
        """Return the workers heard of in the last `within_seconds`."""
        age = (now_ms() - table.c.beat_at) / 1000.0
        query = sa.select(table, age.label("age_seconds")).where(age <= within_seconds).order_by(table.c.id)
        with self._engine.connect() as connection:
            rows = connection.execute(query).mappings().all()
        return [
            Worker(**{name: row[name] for name in Worker.__dataclass_fields__ if name != "age_seconds"},
                   age_seconds=float(row["age_seconds"]))
            for row in rows
        ]  # fmt: skip

    def forget(self, silent_seconds: float) -> None:
        """Remove workers not heard of for `silent_seconds`."""
        with self._engine.begin() as connection:
            connection.execute(table.delete().where(table.c.beat_at < now_ms() - int(silent_seconds * 1000)))

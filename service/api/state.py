"""The objects that routes use, stored in ``app.state``."""

from __future__ import annotations

from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import Depends, Request

from ..database.damage import Checkup
from ..jobs.retention import Retention
from ..jobs.store import Jobs
from ..jobs.worker_registry import Workers
from ..settings import Settings
from ..storage.base import Storage
from .auth import Keys
from .intake.idempotency import Claims
from .intake.inspection import Inspector
from .metrics import ApiMetrics
from .rate_limit import Rates
from .results.conversion import Converter
from .shutdown import Shutdown
from .watch import Watch


class State:
    """The parts of the API process."""

    settings: Settings
    keys: Keys
    rates: Rates
    shutdown: Shutdown
    metrics: ApiMetrics
    engine: sa.Engine
    storage: Storage
    jobs: Jobs
    retention: Retention
    claims: Claims
    watch: Watch
    workers: Workers
    checkup: Checkup
    inspector: Inspector
    converter: Converter


def _state(request: Request) -> Any:
    return request.app.state


StateIn = Annotated[State, Depends(_state)]

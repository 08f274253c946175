"""What the routes work with, kept in ``app.state``."""

from __future__ import annotations

from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import Depends, Request

from .auth import Keys
from .conversion import Converter
from .idempotency import Claims
from .inspection import Inspector
from .jobs import Jobs
from .metrics import ApiMetrics
from .rates import Rates
from .retention import Retention
from .settings import Settings
from .stop import Stop
from .storage import Storage
from .watch import Watch
from .workers import Workers


class State:
    """The parts of the API process."""

    settings: Settings
    keys: Keys
    rates: Rates
    stop: Stop
    metrics: ApiMetrics
    engine: sa.Engine
    storage: Storage
    jobs: Jobs
    retention: Retention
    claims: Claims
    watch: Watch
    workers: Workers
    inspector: Inspector
    converter: Converter


def _state(request: Request) -> Any:
    return request.app.state


StateIn = Annotated[State, Depends(_state)]

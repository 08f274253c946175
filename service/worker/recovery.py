"""The worker's side of DBOS: join the queues, recover the work of lost workers, fail jobs that DBOS has given up."""

from __future__ import annotations

import logging

import sqlalchemy as sa
from dbos import DBOS, DBOSConfig

from ..jobs import callback
from ..jobs.attempts import Attempts
from ..jobs.dbos_contract import APPLICATION_NAME, APPLICATION_VERSION, GIVEN_UP, SERIALIZER
from ..jobs.lanes import LANES, SHARD_CONCURRENCY, SHARDS_QUEUE
from ..jobs.worker_registry import Workers
from ..problems import Problem
from ..settings import Settings

log = logging.getLogger(__name__)

FORGET_FACTOR = 10  # a worker silent this many times longer than stale is dropped from the table


def launch(settings: Settings, engine: sa.Engine) -> None:
    """Join the queues; work that an earlier process of this name left behind is queued again by the engine."""
    config: DBOSConfig = {
        "name": APPLICATION_NAME,
        "system_database_url": settings.resolved_database_url,
        "system_database_engine": engine,
        "executor_id": settings.executor_id,
        "application_version": APPLICATION_VERSION,
        "serializer": SERIALIZER,
        "enable_otlp": False,
        "log_level": settings.log_level.upper() if settings.log_level in ("debug", "error") else "WARNING",
    }
    DBOS(config=config)
    concurrency = {lane.queue: lane.concurrency for lane in LANES} | {SHARDS_QUEUE: SHARD_CONCURRENCY}
    concurrency[callback.QUEUE] = callback.CONCURRENCY
    DBOS.listen_queues(list(concurrency))
    DBOS.launch()
    for queue, jobs in concurrency.items():
        DBOS.register_queue(
            queue,
            worker_concurrency=jobs,
            polling_interval_sec=settings.poll_seconds,
            on_conflict="always_update",
        )


def take_over(settings: Settings, workers: Workers) -> list[str]:
    """Queue again what workers that are not alive any more left behind; return the names of those workers."""
    alive = {worker.id for worker in workers.alive(settings.worker_stale_seconds)}
    pending = DBOS.list_workflows(status="PENDING", load_input=False, load_output=False)
    holders = {workflow.executor_id for workflow in pending if workflow.executor_id is not None}
    lost = sorted(holders - alive - {settings.executor_id})
    if lost:
        log.warning("taking over the jobs of %s", ", ".join(lost))
        DBOS._recover_pending_workflows(lost)
    workers.forget(FORGET_FACTOR * settings.worker_stale_seconds)
    return lost


def fail_given_up(attempts: Attempts) -> None:
    """Fail the jobs that the engine has given up; a backstop, since the workflow ends its job itself."""
    live = attempts.live()
    if not live:
        return
    for workflow in DBOS.list_workflows(workflow_ids=live, status=GIVEN_UP, load_input=False, load_output=False):
        log.error("the engine gave job %s up: %s", workflow.workflow_id, workflow.status)
        problem = Problem(
            "internal_error", "The service failed because of an internal error.", hint="Submit the file again."
        )
        if not attempts.fail(workflow.workflow_id, problem.body(f"/jobs/{workflow.workflow_id}")):
            attempts.cancel(workflow.workflow_id)

"""The HTTP application: routes and what they need, nothing that computes. See ``docs/api.md``."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial

from fastapi import FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.middleware.cors import CORSMiddleware

import pcdnf

from ..database.damage import Checkup
from ..database.engine import create_engine
from ..database.migrations import migrate
from ..exposure import check_exposure
from ..jobs.retention import SCRATCH_SECONDS, Retention
from ..jobs.store import Jobs
from ..jobs.worker_registry import Workers
from ..settings import Settings
from ..storage.base import Storage
from ..storage.open import open_storage
from . import error_handlers, openapi
from .auth import Keys
from .intake.idempotency import Claims
from .intake.inspection import Inspector
from .metrics import ApiMetrics, Deployment
from .middleware.access_log import AccessLog
from .middleware.compression import Compression
from .middleware.cross_origin import cross_origin
from .middleware.guard import Guard
from .middleware.same_origin import Origins
from .openapi import errors
from .rate_limit import Rates
from .results.conversion import Converter
from .routes import batches, jobs, models, pages, probes
from .sandbox import Sandbox
from .shutdown import Shutdown
from .watch import Watch

log = logging.getLogger(__name__)

STORAGE_SECONDS = 15.0  # that a caller waits for a storage that does not answer
LOCK_SECONDS = 4.0  # that a caller waits for a job database that another program has locked
CONNECTIONS = 40  # to SQLite, as many as there are threads for requests, so that no request waits for one
CLEAR_SECONDS = 3600.0


def create_app(settings: Settings | None = None) -> FastAPI:
    """Return the application; ``uvicorn --factory service.api.app:create_app``.

    Raises
    ------
    SettingsError
        If the service would be open to the network without a key, or the file of keys cannot be read.
    """
    settings = settings or Settings()
    check_exposure(settings)
    app = FastAPI(
        title="PCDNF point-cloud denoising",
        version=pcdnf.__version__,
        summary="Upload a point cloud, get it back with less noise and with normals.",
        lifespan=_lifespan,
        docs_url=None,  # see pages
        redoc_url=None,
        responses=errors(),
        generate_unique_id_function=lambda route: route.name,
    )
    app.state.settings = settings
    app.state.keys = Keys.of(settings)
    app.state.rates = Rates(settings.caller_requests_per_minute)
    app.add_middleware(Compression)
    app.add_middleware(Origins, settings=settings)
    app.state.shutdown = Shutdown()
    app.state.metrics = ApiMetrics()
    if settings.origins:
        app.add_middleware(CORSMiddleware, **cross_origin(settings))
    app.add_middleware(Guard, max_requests=settings.max_requests, shutdown=app.state.shutdown)
    app.add_middleware(AccessLog, metrics=app.state.metrics)
    error_handlers.install(app)
    probes.install(app)
    app.include_router(models.router)
    app.include_router(jobs.router)
    app.include_router(batches.router)
    pages.install(app)
    openapi.install(app)
    return app


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    settings: Settings = app.state.settings
    await run_in_threadpool(migrate, settings)
    engine = create_engine(settings, busy_seconds=LOCK_SECONDS, most=CONNECTIONS)
    storage = await run_in_threadpool(partial(open_storage, settings, patience=STORAGE_SECONDS))
    app.state.engine, app.state.storage = engine, storage
    app.state.jobs = await run_in_threadpool(Jobs, engine, storage, settings)
    app.state.retention = Retention(engine, storage, app.state.jobs, settings)
    app.state.claims = Claims(engine)
    app.state.watch = Watch(app.state.jobs, settings.max_streams)
    app.state.workers = Workers(engine)
    app.state.checkup = Checkup(settings)
    sandbox = Sandbox(settings)
    app.state.inspector = Inspector(sandbox, settings)
    app.state.converter = Converter(sandbox, app.state.jobs, storage, app.state.retention)
    app.state.metrics.registry.register(Deployment(engine, storage, settings))
    clearing = asyncio.create_task(keep_clear(storage))
    try:
        yield
    finally:
        clearing.cancel()
        app.state.jobs.close()
        engine.dispose()


async def keep_clear(storage: Storage) -> None:
    """Remove now and every hour the files that a writer on this machine left half written, until cancelled."""
    while True:
        try:
            await run_in_threadpool(storage.clear_scratch, SCRATCH_SECONDS)
        except OSError:
            log.exception("half-written files could not be removed; trying again")
        await asyncio.sleep(CLEAR_SECONDS)

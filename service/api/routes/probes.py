"""Routes for other programs: liveness, readiness, metrics, and the models.

They serve Kubernetes' probes, Prometheus, and the reading part of the Open Inference Protocol (V2). Clouds of millions
of points do not fit into tensors in JSON, so there is no ``/v2/models/{name}/infer``.
"""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import Depends, FastAPI, Header, Response
from prometheus_client.exposition import choose_encoder
from pydantic import BaseModel, Field

import pcdnf

from ...problems import Problem
from .. import schemas
from ..auth import caller
from ..openapi import CALLER, METRICS, errors
from ..readiness import Readiness, readiness
from ..state import State, StateIn


class Live(BaseModel):
    """The server runs."""

    live: bool = True


class Ready(BaseModel):
    """The server takes work."""

    ready: bool = True


class Server(BaseModel):
    """The server."""

    name: str = "pcdnf"
    version: str = pcdnf.__version__
    extensions: list[str] = []


class Tensor(BaseModel):
    """An input or an output of a model."""

    name: str
    datatype: Literal["FP32", "FP64"]
    shape: list[int] = Field(description="-1: any number of points")


class ModelMetadata(BaseModel):
    """A model; clouds are sent to it by `POST /denoise?model=NAME`."""

    name: str
    versions: list[str] = Field(description="The SHA-256 of its weights")
    platform: str
    inputs: list[Tensor]
    outputs: list[Tensor]


def install(app: FastAPI) -> None:
    """Answer these questions from `app`."""

    @app.get("/livez", tags=["probes"])
    async def alive() -> dict[str, str]:
        """Answer while the event loop of the API runs."""
        return {"status": "alive"}

    @app.get("/readyz", tags=["probes"], responses=errors("not_ready"))
    def ready(state: StateIn) -> Readiness:
        """Answer 200 once a worker has loaded and warmed its model, and database and disk are in order."""
        return _readiness(state)

    @app.get(
        "/metrics",
        tags=["probes"],
        response_class=Response,
        dependencies=[Depends(caller)],
        responses=METRICS | errors(*CALLER, "invalid_parameters"),
    )
    def metrics(state: StateIn, accept: Annotated[str, Header()] = "") -> Response:
        """Return the metrics for Prometheus; requires a key if the service has keys."""
        encode, media_type = choose_encoder(accept)
        return Response(encode(state.metrics.registry), media_type=media_type, headers={"Cache-Control": "no-store"})

    @app.get("/v2", tags=["open inference protocol"], dependencies=[Depends(caller)], responses=errors(*CALLER))
    async def server() -> Server:
        """Return name and version."""
        return Server()

    @app.get("/v2/health/live", tags=["open inference protocol"])
    async def server_live() -> Live:
        """Answer as `/livez`."""
        return Live()

    @app.get("/v2/health/ready", tags=["open inference protocol"], responses=errors("not_ready"))
    def server_ready(state: StateIn) -> Ready:
        """Answer 200 where `/readyz` does."""
        _readiness(state)
        return Ready()

    @app.get(
        "/v2/models/{model}",
        tags=["open inference protocol"],
        dependencies=[Depends(caller)],
        responses=errors(*CALLER, "model_not_found", "invalid_parameters"),
    )
    async def model(model: str) -> ModelMetadata:
        """Return what a model takes and gives."""
        return _metadata(model)

    @app.get(
        "/v2/models/{model}/ready",
        tags=["open inference protocol"],
        dependencies=[Depends(caller)],
        responses=errors(*CALLER, "model_not_found", "invalid_parameters", "not_ready"),
    )
    def model_ready(state: StateIn, model: str) -> Ready:
        """Answer 200 for a model there is, where `/readyz` does; it is loaded at its first job."""
        _metadata(model)
        _readiness(state)
        return Ready()


def _readiness(state: State) -> Readiness:
    return readiness(
        state.workers, state.engine, state.storage, state.settings, state.checkup, stopping=state.shutdown.begun
    )


def _metadata(name: str) -> ModelMetadata:
    known = schemas.shipped()
    if name not in known:
        raise Problem(
            "model_not_found", f"There is no model named {name[:40]!r}.", hint=f"Use one of {', '.join(known)}."
        )
    cloud = [
        Tensor(name="points", datatype="FP64", shape=[-1, 3]),
        Tensor(name="normals", datatype="FP32", shape=[-1, 3]),
    ]
    return ModelMetadata(
        name=name, versions=[known[name].sha256], platform="pytorch_safetensors", inputs=cloud, outputs=cloud
    )

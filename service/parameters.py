"""The parameters of a job: from the query, the form or both, and nothing that is not known."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

from fastapi import Request
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pcdnf import DEFAULT_ITERATIONS

from . import catalogue
from .problems import Problem, from_validation
from .settings import Settings

SEED_LIMIT = 2**32


class Parameters(BaseModel):
    """What a job is run with."""

    model_config = ConfigDict(extra="forbid")

    iterations: int = Field(
        DEFAULT_ITERATIONS, ge=1, description="Passes over the cloud; each starts from the result of the last"
    )
    model: str = Field("", description="Name of a model of `GET /models`; empty for the default")
    seed: int = Field(0, ge=0, lt=SEED_LIMIT, description="Seed of every random choice")
    normals: Literal["pca", "input"] = Field(
        "pca", description="Where the first normals come from: estimated, or those of the file"
    )
    nonfinite: Literal["reject", "drop"] = Field(
        "reject", description="What to do about points that are NaN or infinite"
    )


def job_parameters(given: Iterable[tuple[str, str]], settings: Settings) -> Parameters:
    """Return the parameters in force, defaults filled in.

    Raises
    ------
    Problem
        422, naming every parameter that is unknown, given twice or out of range.
    """
    values: dict[str, str] = {}
    twice = []
    for name, value in given:
        if name in values:
            twice.append({"loc": (name,), "msg": "given more than once"})
        values[name] = value
    if twice:
        raise from_validation(twice)
    try:
        parameters = Parameters.model_validate(values)
    except ValidationError as error:
        raise from_validation(_in_words(error)) from error
    if parameters.iterations > settings.max_iterations:
        raise Problem(
            "invalid_parameters",
            f"iterations: {parameters.iterations} passes were asked for, this service allows "
            f"{settings.max_iterations}.",
            limit=settings.max_iterations,
            actual=parameters.iterations,
        )
    name = parameters.model or settings.default_model
    if name not in catalogue.shipped():
        raise Problem(
            "invalid_parameters",
            "model: there is no such model.",
            hint=f"Use one of {', '.join(sorted(catalogue.shipped()))}.",
        )
    return parameters.model_copy(update={"model": name})


def _in_words(error: ValidationError) -> list[dict[str, Any]]:
    words = {"extra_forbidden": "there is no such parameter"}
    return [{"loc": e["loc"], "msg": words.get(e["type"], e["msg"])} for e in error.errors()]


def only_query(*known: str) -> Any:
    """Return a dependency that refuses every query parameter but `known`."""

    def check(request: Request) -> None:
        unknown = [{"loc": (name,), "msg": "there is no such parameter"} for name in request.query_params
                   if name not in known]  # fmt: skip
        if unknown:
            raise from_validation(unknown)

    return check

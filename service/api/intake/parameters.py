"""The parameters of a job from the query and the form; unknown ones are refused."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Annotated, Any, Literal

from fastapi import Request
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic_core import PydanticCustomError

from pcdnf.inference.options import ChoiceError, check_fast, check_iterations, check_radius, check_sensor

from ...jobs.callback import CallbackError, check_url
from ...jobs.job import ignored_classes
from ...problems import Problem, from_validation
from ...settings import Settings
from .. import schemas

SEED_LIMIT = 2**32
FAST_HINT = "Leave `fast` out, or choose another model."
_CASED = ("model", "callback_url")  # values whose case means something


def _iterations(value: int | str) -> int | str:
    with _as_value_error():
        return check_iterations(value) or "auto"


def _radius(value: str) -> str:
    with _as_value_error():
        check_radius(value)
    return value


def _classes(value: str) -> str:
    if not re.fullmatch(r"([0-9]{1,3}(,[0-9]{1,3}){0,31})?", value):
        raise ValueError("must be 1 to 32 class numbers with commas between them, such as 7,18")
    return value


def _sensor(value: str) -> str:
    with _as_value_error():
        check_sensor(value)
    return value


@contextmanager
def _as_value_error() -> Iterator[None]:
    """Let pydantic report the message of the package."""
    try:
        yield
    except ChoiceError as error:
        raise PydanticCustomError("choice", "{reason}", {"reason": str(error)}) from error


class Parameters(BaseModel):
    """The parameters of a job."""

    model_config = ConfigDict(extra="forbid")

    iterations: Annotated[int | Literal["auto"], BeforeValidator(_iterations)] = Field(
        "auto",
        description="Passes over the cloud, each from the result of the last: `auto` by its noise, or a number",
        examples=["auto", 2],
    )
    radius: Annotated[str, AfterValidator(_radius)] = Field(
        "auto",
        description="Size of the neighbourhoods: `auto` by noise and spacing, a length in the cloud's unit, or a share "
        "of its diagonal such as `4%`",
        examples=["auto", "4%", "0.05"],
    )
    fast: bool = Field(
        False, description="Use half as many neighbours for each point: about 1.4 times as fast, a little less exact"
    )
    model: str = Field("", description="Name of a model of `GET /models`; empty for the default")
    seed: int = Field(0, ge=0, lt=SEED_LIMIT, description="Seed of every random choice")
    normals: Literal["auto", "pca", "input"] = Field(
        "auto",
        description="Source of the initial normals: estimated at a scale that suits the noise, from 24 neighbours, or "
        "those of the file. The side is that of the file's normals, if it has any, else that of its scanner",
    )
    orient: bool = Field(False, description="Turn the normals of the result to one side of the surface")
    outliers: Literal["keep", "drop", "mark"] = Field(
        "keep",
        description="Treatment of points that belong to no surface: far from all others, floating beside a surface, or "
        "between two surfaces along a ray. After `drop` the result names the removed rows; `mark` adds a column "
        "`outlier`, 1 or 0",
    )
    sensor: Annotated[str, AfterValidator(_sensor)] = Field(
        "",
        description="Where the scanner stood, x,y,z in the coordinates of the cloud. Empty: what a PTX, a gridded E57 "
        "or an organised PCD says",
        examples=["1.5,0,2"],
    )
    nonfinite: Literal["keep", "reject", "drop"] = Field(
        "keep",
        description="Treatment of points that are NaN or infinite: return them in their places, refuse the file, or "
        "remove them",
    )
    diagnostics: bool = Field(
        False,
        description="Whether the result has columns on what was done to each point: `displacement`, "
        "`estimated_noise`, and a `confidence` from 0 to 1",
    )
    ignore_classes: Annotated[str, AfterValidator(_classes)] = Field(
        "",
        description="Classes of a LAS or LAZ whose points come back unchanged and are left out of the fit: `7,18` for "
        "noise",
        examples=["7,18"],
    )
    coordinates: Literal["keep", "float32", "float64"] = Field(
        "keep",
        description="Type of the result's coordinates. `float32` far from the origin are moved by an offset that the "
        "result records. LAS, LAZ and E57 have their own types",
    )

    callback_url: str = Field(
        "",
        description="Address to which a signed message is sent when the job has ended, on a host that the operator of "
        "the service allows",
        examples=["https://hooks.example.org/denoised"],
    )

    def in_force(self) -> dict[str, Any]:
        """Return the parameters as a job shows them."""
        return self.model_dump(exclude=set() if self.callback_url else {"callback_url"})

    @property
    def classes(self) -> list[int]:
        """The numbers of `ignore_classes`."""
        return ignored_classes(self.ignore_classes)


def job_parameters(given: Iterable[tuple[str, str]], settings: Settings) -> Parameters:
    """Return the parameters in force, defaults filled in.

    Raises
    ------
    Problem
        422, naming every parameter that is unknown, out of range, or given twice with different values.
    """
    values: dict[str, str] = {}
    twice = []
    for name, text in given:
        value = text.strip() if name in _CASED else text.strip().lower()
        if values.get(name, value) != value:
            twice.append({"loc": (name,), "msg": "given twice, with different values"})
        values[name] = value
    if twice:
        raise from_validation(twice)
    try:
        parameters = Parameters.model_validate(values)
    except ValidationError as error:
        raise from_validation(error.errors()) from error
    iterations = parameters.iterations
    if iterations != "auto" and iterations > settings.max_iterations:
        raise Problem(
            "invalid_parameters",
            f"iterations: the job asks for {iterations} passes, but this service allows {settings.max_iterations}.",
            hint=f"Ask for at most {settings.max_iterations} passes, or for `auto`.",
            limit=settings.max_iterations,
            actual=iterations,
        )
    if parameters.callback_url:
        _check_callback(parameters.callback_url, settings)
    name = parameters.model or settings.default_model
    if name not in schemas.shipped():
        raise Problem(
            "invalid_parameters",
            f"model: there is no model named {name[:40]!r}.",
            hint=f"Use one of {', '.join(sorted(schemas.shipped()))}.",
        )
    try:
        check_fast(parameters.fast, schemas.shipped()[name].kind)
    except ChoiceError as error:
        raise Problem("invalid_parameters", f"fast: {error}", hint=error.hint or FAST_HINT) from error
    return parameters.model_copy(update={"model": name})


def _check_callback(url: str, settings: Settings) -> None:
    try:
        check_url(url, settings.callback_host_names)
    except CallbackError as error:
        raise Problem(
            "invalid_parameters",
            f"callback_url: {error}.",
            hint="Poll the job or follow its events, or ask the operator of the service to allow the host.",
        ) from error


def only_query(*known: str) -> Any:
    """Return a dependency that refuses every query parameter but `known`."""

    def check(request: Request) -> None:
        unknown = [{"loc": (name,), "type": "extra_forbidden"} for name in request.query_params if name not in known]
        if unknown:
            raise from_validation(unknown)

    return check

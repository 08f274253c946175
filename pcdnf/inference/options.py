"""Options of a run, checked without importing a network: passes, radius, sensor, initial normals, fast mode."""

from __future__ import annotations

import math
import operator
from typing import Literal, get_args

from ..errors import PcdnfError

InitialNormals = Literal["auto", "pca", "input"]
"""Where initial normals come from; see :meth:`pcdnf.denoiser.Denoiser.prepare`."""
MOST_ITERATIONS = 100
"""Largest number of passes; no level of noise gains from more than three."""
FAST_NEIGHBOURS = {"lite": 128}
"""Neighbours per point in fast mode, for the kinds of networks that were trained with so few."""


class ChoiceError(PcdnfError):
    """A number of passes, a radius, initial normals or a mode that cannot be used."""


def check_iterations(value: int | str) -> int | None:
    """Check a number of passes; None for "auto".

    Raises
    ------
    ChoiceError
        ``invalid_iterations``: neither "auto" nor a whole number from 1 to ``MOST_ITERATIONS``.
    """
    if value == "auto":
        return None
    try:
        digits = isinstance(value, str) and value.isdecimal() and len(value) < 10
        number = operator.index(int(value) if digits else value)  # type: ignore[arg-type]
    except TypeError:
        number = 0
    if not 1 <= number <= MOST_ITERATIONS:
        raise ChoiceError(
            f"Iterations must be auto or a whole number from 1 to {MOST_ITERATIONS}, not {str(value)[:40]!r}.",
            code="invalid_iterations",
            hint="Omit it to choose it automatically.",
        )
    return number


def check_radius(value: float | str) -> tuple[float, bool] | None:
    """Check a radius: (number, whether it is relative to the diagonal); None for "auto".

    Raises
    ------
    ChoiceError
        ``invalid_radius``: neither "auto", a positive length, nor a share up to 100%.
    """
    if value == "auto":
        return None
    text = str(value).strip()
    relative = text.endswith("%")
    try:
        number = float(text.removesuffix("%")) / (100 if relative else 1)
    except ValueError:
        number = 0.0
    if not (0 < number <= (1 if relative else math.nextafter(math.inf, 0))):
        raise ChoiceError(
            f"The radius must be auto, a length in the cloud's unit, or a percentage of its diagonal such as 4%, "
            f"not {text[:40]!r}.",
            code="invalid_radius",
            hint="Omit it to choose it automatically.",
        )
    return number, relative


def check_sensor(value: str) -> tuple[float, float, float] | None:
    """Check a scanner's position such as ``1.5,0,2``; None for an empty text.

    Raises
    ------
    ChoiceError
        ``invalid_sensor``: not three finite numbers.
    """
    if not value:
        return None
    try:
        x, y, z = (float(part) for part in value.split(","))
    except ValueError:
        x = y = z = math.nan
    if not math.isfinite(x + y + z):
        raise ChoiceError(
            f"The sensor must be three finite numbers with commas between them, such as 1.5,0,2, not {value[:40]!r}.",
            code="invalid_sensor",
            hint="Give the scanner's position in the coordinates of the cloud, or omit it.",
        )
    return x, y, z


def check_initial(value: str) -> InitialNormals:
    """Check where initial normals come from.

    Raises
    ------
    ChoiceError
        ``invalid_initial``: none of "auto", "pca" and "input".
    """
    for known in get_args(InitialNormals):
        if value == known:
            return known  # type: ignore[no-any-return]
    raise ChoiceError(
        f"The initial normals must be auto, pca or input, not {str(value)[:40]!r}.",
        code="invalid_initial",
        hint="Omit it to estimate them.",
    )


def check_fast(fast: bool, kind: str) -> int | None:
    """Return the neighbours per point for a kind of network, None for the usual number.

    Raises
    ------
    ChoiceError
        ``no_fast_form``: this kind was trained with all its neighbours.
    """
    if fast and kind not in FAST_NEIGHBOURS:
        raise ChoiceError("This model has no fast mode.", code="no_fast_form", hint="Use pcdnf-lite, or omit fast.")
    return FAST_NEIGHBOURS[kind] if fast else None

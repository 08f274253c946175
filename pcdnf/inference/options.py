"""What a caller may choose, checked without importing a network: iterations, radius, and the fast form."""

from __future__ import annotations

import math
import operator
from typing import Literal, get_args

from ..errors import PcdnfError

InitialNormals = Literal["auto", "pca", "input"]
"""Where raw normals come from; see :meth:`pcdnf.denoiser.Denoiser.prepare`."""
MOST_ITERATIONS = 100
"""That can be asked for at all; no noise gains from more than three."""
FAST_NEIGHBOURS = {"lite": 128}
"""Neighbours a point in the fast form, by the kind of network: those that were trained with so few."""


class ChoiceError(PcdnfError):
    """Iterations, a radius, raw normals or a form that cannot be used."""


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
            f"Iterations are given as auto or a whole number from 1 to {MOST_ITERATIONS}, not {str(value)[:40]!r}.",
            code="invalid_iterations",
            hint="Leave it out to have it chosen.",
        )
    return number


def check_radius(value: float | str) -> tuple[float, bool] | None:
    """Radius as (number, whether it is a share of the diagonal), None for "auto".

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
            f"A radius is given as auto, a length in the cloud's unit, or a share of its diagonal such as 4%, "
            f"not {text[:40]!r}.",
            code="invalid_radius",
            hint="Leave it out to have it chosen.",
        )
    return number, relative


def check_initial(value: str) -> InitialNormals:
    """Where raw normals come from.

    Raises
    ------
    ChoiceError
        ``invalid_initial``: none of "auto", "pca" and "input".
    """
    for known in get_args(InitialNormals):
        if value == known:
            return known  # type: ignore[no-any-return]
    raise ChoiceError(
        f"Raw normals are auto, pca or input, not {str(value)[:40]!r}.",
        code="invalid_initial",
        hint="Leave it out to have them estimated.",
    )


def check_fast(fast: bool, kind: str) -> int | None:
    """Neighbours a point in the fast form of a kind of network, None for the usual one.

    Raises
    ------
    ChoiceError
        ``no_fast_form``: this kind was trained with all its neighbours.
    """
    if fast and kind not in FAST_NEIGHBOURS:
        raise ChoiceError(
            "This model has no fast form.", code="no_fast_form", hint="Take pcdnf-lite, or leave fast out."
        )
    return FAST_NEIGHBOURS[kind] if fast else None

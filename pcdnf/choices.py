"""What a caller may choose, checked without importing a network: iterations and radius."""

from __future__ import annotations

import math

from .errors import PcdnfError


class ChoiceError(PcdnfError):
    """Iterations or a radius that cannot be used."""


def check_iterations(value: int | str) -> int | None:
    """Iterations as a number, None for "auto".

    Raises
    ------
    ChoiceError
        ``invalid_iterations``: neither "auto" nor a whole number from 1 on.
    """
    if value == "auto":
        return None
    number = int(value) if isinstance(value, int) or value.isdecimal() else 0
    if number < 1:
        raise ChoiceError(
            f"Iterations are given as auto or a whole number from 1 on, not {str(value)[:40]!r}.",
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

"""Colours and intensity between formats: 8, 12 and 16 bits, and floats from 0 to 1 or to 255."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .roles import Triple, find_colours

Column = NDArray[Any]

BYTE, WORD = 255, 65535


@dataclass(frozen=True)
class Colours:
    """The colours of a cloud.

    Attributes
    ----------
    names : tuple of str
        Of the three columns.
    values : (N, 3) array
        As stored.
    brightest : float
        The value that stands for full brightness.
    """

    names: Triple
    values: NDArray[Any]
    brightest: float

    def scaled(self, top: int) -> NDArray[np.uint16]:
        """(N, 3) whole numbers from 0 to ``top``, 255 or 65535; 0 where the stored value is not finite."""
        return _scaled(self.values, self.brightest, top)

    def is_exact(self, top: int) -> bool:
        """Whether :meth:`scaled` loses nothing: the stored values come back from it, to the digits of their type."""
        if self.values.dtype.kind in "iu":
            back = np.rint(self.scaled(top) * (self.brightest / top))
            return bool((back == self.values).all())
        back = self.scaled(top) * (self.brightest / top)
        return bool((np.abs(back - self.values) <= 1e-6 * self.brightest).all())


def _scaled(values: Column, brightest: float, top: int) -> NDArray[np.uint16]:
    if values.dtype.kind in "iu" and brightest == top:
        return values.astype(np.uint16)
    numbers = np.nan_to_num(values.astype(np.float64), nan=0.0, posinf=brightest, neginf=0.0)
    whole: NDArray[np.uint16] = np.rint(np.clip(numbers / brightest, 0, 1) * top).astype(np.uint16)
    return whole


def colours_of(attributes: dict[str, Column], brightest: float | None = None) -> Colours | None:
    """Return the colours among the columns; None if there are none, or if some are negative or above 16 bits.

    Parameters
    ----------
    attributes : dict of str to (N, ...) array
    brightest : float, optional
        The value of full brightness, where the file says it; by default it follows from the values.
    """
    names = find_colours(name for name, column in attributes.items() if _is_plain(column))
    if names is None:
        return None
    values = np.stack([attributes[name] for name in names], axis=1)
    found = _brightest(values) if brightest is None else brightest
    return None if found is None else Colours(names, values, found)


def _is_plain(column: Column) -> bool:
    return column.ndim == 1 and column.dtype.kind in "iuf"


def _brightest(values: NDArray[Any]) -> float | None:
    """Return the value of full brightness: 255, 65535 (65280 if 8 bits were shifted by 8), or 1 for floats."""
    finite = values[np.isfinite(values)] if values.dtype.kind == "f" else values
    if not finite.size:
        return BYTE
    most = float(finite.max())
    if float(finite.min()) < 0 or most > WORD:
        return None
    if values.dtype.kind == "f" and most <= 1:
        return 1.0
    if values.dtype.itemsize == 1 or most <= BYTE:
        return BYTE
    if values.dtype.kind in "iu" and (values % 257).any() and not (values % 256).any():
        return BYTE * 256
    return WORD


def sixteen_bit_intensity(column: Column) -> tuple[NDArray[np.uint16] | None, str]:
    """Return a column of intensity as whole numbers of 16 bits, and what was done to it.

    Returns
    -------
    values : (N,) uint16 array or None
        None where it holds negative numbers or ones beyond 16 bits.
    how : str
        Empty where nothing is lost.
    """
    numbers = column.astype(np.float64)
    finite = np.isfinite(numbers)
    known = numbers[finite]
    if column.ndim != 1 or column.dtype.kind not in "iuf" or (known.size and (known.min() < 0 or known.max() > WORD)):
        return None, ""
    holes = "" if finite.all() else "; NaN and infinity became 0"
    numbers = np.where(finite, numbers, 0)
    if known.size and column.dtype.kind == "f" and known.max() <= 1 and (known != np.rint(known)).any():
        return np.rint(numbers * WORD).astype(np.uint16), f"spread from 0..1 over 0..65535{holes}"
    whole = np.rint(numbers)
    rounded = "" if np.array_equal(whole, numbers) else "rounded to whole numbers"
    return whole.astype(np.uint16), f"{rounded}{holes}".removeprefix("; ")

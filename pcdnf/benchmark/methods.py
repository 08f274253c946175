"""Methods that are compared: the noisy input, our models after any number of passes, and :mod:`.peers`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from .._version import __version__
from ..errors import PcdnfError
from ..geometry.normals import pca_normals

if TYPE_CHECKING:
    from ..denoiser import Denoiser

Group = Literal["input", "ours", "peer", "normals"]
"""``normals`` estimates normals of the noisy points and leaves the points alone."""
Iterations = int | Literal["auto"]


@dataclass(frozen=True)
class Output:
    """Result of a method for a noisy cloud.

    Attributes
    ----------
    points : (M, 3) float array
        In the order of the input where M is its number of points.
    normals : (M, 3) float array
    facts : dict
        Further facts for the report, such as the passes that ``auto`` chose.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.floating]
    facts: dict[str, Any] = field(default_factory=dict)


class Method(Protocol):
    """A row of the tables.

    Attributes
    ----------
    name, group
    identity : dict of str to str
        All that its output depends on besides the input; results are found again by it.
    """

    @property
    def name(self) -> str:
        """Name in the tables."""

    @property
    def group(self) -> Group:
        """Group of rows it is compared in."""

    @property
    def identity(self) -> dict[str, str]:
        """All that its output depends on besides the input."""

    def run(self, points: NDArray[np.float64], level: float) -> Output:
        """Process points (N, 3) whose noise is ``level`` per cent of the clean diagonal."""


@dataclass(frozen=True)
class Noisy:
    """The input as it is, with the initial normals that our models start from."""

    name: str = "noisy"
    group: Group = "input"

    @property
    def identity(self) -> dict[str, str]:
        """All that the output depends on besides the input."""
        return {"method": self.name, "version": __version__}

    def run(self, points: NDArray[np.float64], level: float) -> Output:  # noqa: ARG002
        """Leave the points, estimate normals from 24 neighbours."""
        return Output(points, pca_normals(points))


@dataclass(frozen=True)
class Ours:
    """One model, so many passes.

    Attributes
    ----------
    name : str
    denoiser : Denoiser
        With the facts of its checkpoint.
    iterations : int or "auto"
    """

    name: str
    denoiser: Denoiser
    iterations: Iterations
    group: Group = "ours"

    @property
    def identity(self) -> dict[str, str]:
        """All that the output depends on besides the input."""
        info = self.denoiser.info
        return {
            "method": "pcdnf",
            "weights_sha256": info.sha256 if info else "",
            "iterations": str(self.iterations),
            "version": __version__,
            "device": self.denoiser.device,
            "precision": self.denoiser.precision,
        }

    def run(self, points: NDArray[np.float64], level: float) -> Output:  # noqa: ARG002
        """Denoise; the passes that were made are noted."""
        passes: Any = self.iterations
        result = self.denoiser.denoise(points, iterations=passes)
        facts = {"iterations": result.metadata["iterations"], "flagged": int(result.flagged.sum())}
        return Output(result.points, result.normals, facts)


def our_methods(
    models: Sequence[str], iterations: Sequence[Iterations], *, device: str = "auto", precision: str = "auto"
) -> list[Method]:
    """Return one method for each model and number of passes.

    Raises
    ------
    PcdnfError
        ``same_model`` for one model named twice, and what loading raises.
    """
    from ..denoiser import Denoiser

    rows: list[Method] = []
    seen: dict[str, str] = {}
    for model in models:
        denoiser = Denoiser.load(model, device=device, precision=precision)
        assert denoiser.info is not None
        digest, name = denoiser.info.sha256, denoiser.info.name
        if digest in seen.values():
            raise PcdnfError(f"{model} is named twice.", code="same_model", hint="Name each set of weights once.")
        if name in seen:
            name = f"{name}@{digest[:6]}"
        seen[name] = digest
        for count in iterations:
            label = f"{name} auto" if count == "auto" else f"{name} x {count}"
            rows.append(Ours(label, denoiser, count))
    return rows

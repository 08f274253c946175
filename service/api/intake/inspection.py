"""The check of an upload, in a child process with limits of memory and time. The API process parses nothing."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcdnf.inference.options import check_radius

from ...problems import CATALOGUE, Problem
from ...settings import Settings
from ..sandbox import Sandbox
from .parameters import Parameters

MINIMUM_POINTS = 16  # what the denoiser needs; a test compares the two


@dataclass(frozen=True)
class Inspection:
    """What the check found."""

    format: str
    points: int
    has_normals: bool
    warnings: list[str]
    unpacked: int | None  # bytes of the cloud of a packed file


class Inspector:
    """Runs checks.

    Parameters
    ----------
    sandbox : Sandbox
    settings : Settings
    """

    def __init__(self, sandbox: Sandbox, settings: Settings) -> None:
        self._sandbox = sandbox
        self._settings = settings

    async def inspect(self, path: Path, parameters: Parameters, *, text: bool, unpack_to: Path) -> Inspection:
        """Check a file.

        Parameters
        ----------
        path : Path
        parameters : Parameters
        text : bool
            Whether a file without a known signature is read as plain-text columns.
        unpack_to : Path
            Where the cloud of a packed file goes.

        Raises
        ------
        Problem
            413, 415 or 422 with the code of what is wrong with the file.
        """
        limits = {
            "max_points": self._settings.max_points,
            "max_bytes": self._settings.max_inflated_bytes,
            "minimum_points": MINIMUM_POINTS,
            "nonfinite": parameters.nonfinite,
        }
        options = ["--limits-json", json.dumps(limits), *(["--text"] if text else [])]
        options += ["--ignore-classes", json.dumps(parameters.classes)]
        options += ["--unpack-to", str(unpack_to), "--max-unpacked", str(self._settings.upload_limit)]
        answer = await self._sandbox.ask("pcdnf.formats.sandbox.check", str(path), *options)
        if not answer["ok"]:
            raise file_problem(answer)
        found = Inspection(
            answer["format"], answer["points"], answer["has_normals"], answer["warnings"], answer.get("unpacked")
        )
        _check_radius(parameters, answer["diagonal"])
        if parameters.normals == "input" and not found.has_normals:
            raise Problem(
                "normals_missing", "The parameter normals=input needs normals, but the file has none.",
                hint="Leave `normals` out, and they are estimated.",
            )  # fmt: skip
        return found


def _check_radius(parameters: Parameters, diagonal: float) -> None:
    """Refuse a radius within which the whole cloud lies."""
    radius = check_radius(parameters.radius)
    if radius is not None and not radius[1] and radius[0] > diagonal:
        raise Problem(
            "invalid_parameters",
            f"radius: {radius[0]:g} is more than {diagonal:.6g}, the diagonal of the cloud, in the unit of the file.",
            hint="Leave `radius` out to have it chosen, or ask for a share of the diagonal, such as 4%.",
            limit=diagonal,
            actual=radius[0],
        )


def file_problem(answer: dict[str, Any]) -> Problem:
    """Return the problem for a refusal of the checker: 413 or 415 where the catalogue says so, else 422."""
    code = answer["code"]
    return Problem(
        code,
        answer["detail"],
        hint=answer["hint"] or "Open the file with another program, and save it again.",
        status=None if code in CATALOGUE else 422,
        title=None if code in CATALOGUE else "File cannot be used",
        limit=answer.get("limit"),
        actual=answer.get("actual"),
    )

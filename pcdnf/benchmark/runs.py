"""The runs: a line of ``results.jsonl`` for each (cloud, noise, method), and the cloud that came out.

A line is found again by what it depends on: the input's bytes and the method's identity (weights, versions, device).
What is there is not computed again. A line is written after its cloud, so a kill loses the run under way and no more.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import PcdnfError
from ..metrics import score
from .choice import Choice, run_timed
from .clouds import CleanCloud
from .methods import Group, Method, Output

Floats = NDArray[np.float64]

KEY_LENGTH = 20
"""Hexadecimal digits of a key."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One method on one noisy cloud.

    Attributes
    ----------
    key : str
        Hash of the input and the method's identity; names the file in ``clouds/``.
    cloud, noise, level, method, group
        ``level`` is in per cent of the clean diagonal.
    points : int
        That came out.
    chamfer_distance, point_to_surface, normal_mean, normal_rms : float
        See :mod:`pcdnf.metrics`.
    seconds : float
        Wall time of the method alone.
    identity, facts : dict
    """

    key: str
    cloud: str
    noise: str
    level: float
    method: str
    group: Group
    points: int
    chamfer_distance: float
    point_to_surface: float
    normal_mean: float
    normal_rms: float
    seconds: float
    identity: dict[str, str] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Case:
    """A noisy cloud and what it was made from."""

    clean: CleanCloud
    noise: str
    level: float

    def points(self) -> Floats:
        """Return the noisy points."""
        return self.clean.noisy(self.level, self.noise)


def cases(clouds: Sequence[CleanCloud], noises: Sequence[str], levels: Sequence[float]) -> Iterator[Case]:
    """All of them, cloud by cloud; without noise there is only one kind of it."""
    for cloud in clouds:
        for noise in noises:
            for level in levels:
                if level > 0 or noise in (noises[0], "outliers"):
                    yield Case(cloud, noise, level)


class Results:
    """A folder of results.

    Parameters
    ----------
    folder : Path
        Made where it does not exist.
    fresh : bool
        Compute again what is there.

    Raises
    ------
    PcdnfError
        ``unwritable_folder``.
    """

    def __init__(self, folder: Path, *, fresh: bool = False) -> None:
        self.folder = folder
        self._clouds = cloud_folder(folder)
        self._file = folder / "results.jsonl"
        self._known = {row.key: row for row in (Row(**json.loads(line)) for line in read_lines(self._file))}
        self._fresh = fresh

    def run(
        self, case: Case, methods: Sequence[Method | Choice], *, report: Callable[[Row, bool], None] | None = None
    ) -> list[Row]:
        """Run all methods on one noisy cloud and return their rows in order.

        ``report`` is called with each row and whether it was computed just now.
        """
        points = case.points()
        digest = digest_of(points, case.clean.points, case.clean.normals)
        rows = []
        for method in methods:
            key = key_of(digest, method.identity)
            row = None if self._fresh else self._known.get(key)
            new = row is None or not self._cloud_file(key).exists()
            if row is None or new:
                row = self._computed(case, points, method, key)
                self._write(row)
            # the same input or model may have gone by another name
            row = Row(
                **vars(row)
                | {"cloud": case.clean.name, "noise": case.noise, "level": case.level, "method": method.name}
            )
            rows.append(row)
            if report is not None:
                report(row, new)
        return rows

    def output(self, row: Row, clean: CleanCloud) -> Output:
        """Read the cloud of a row, in the clean cloud's unit; float32 relative to its diagonal."""
        low, diagonal = _frame(clean)
        with np.load(self._cloud_file(row.key), allow_pickle=False) as arrays:
            return Output(arrays["points"].astype(np.float64) * diagonal + low, arrays["normals"])

    def _cloud_file(self, key: str) -> Path:
        return self._clouds / f"{key}.npz"

    def _computed(self, case: Case, points: Floats, method: Method | Choice, key: str) -> Row:
        clean = case.clean

        def error(output: Output) -> float:
            return score(output.points, None, clean.points, clean.normals).point_to_surface

        output, seconds = run_timed(method, points, case.level, error)
        scores = score(output.points, output.normals, clean.points, clean.normals)
        assert scores.normal_mean is not None
        assert scores.normal_rms is not None
        low, diagonal = _frame(case.clean)
        store_cloud(self._clouds, key, Output((output.points - low) / diagonal, output.normals))
        return Row(
            key=key,
            cloud=case.clean.name,
            noise=case.noise,
            level=case.level,
            method=method.name,
            group=method.group,
            points=scores.points,
            chamfer_distance=scores.chamfer_distance,
            point_to_surface=scores.point_to_surface,
            normal_mean=scores.normal_mean,
            normal_rms=scores.normal_rms,
            seconds=round(seconds, 2),
            identity=method.identity,
            facts=output.facts,
        )

    def _write(self, row: Row) -> None:
        append_line(self._file, asdict(row))
        self._known[row.key] = row


def cloud_folder(folder: Path) -> Path:
    """Return the folder of the clouds in a folder of results, made where it does not exist.

    Raises
    ------
    PcdnfError
        ``unwritable_folder``.
    """
    clouds = folder / "clouds"
    try:
        clouds.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PcdnfError(
            f"The folder {folder} cannot be created: {error.strerror}.",
            code="unwritable_folder",
            hint="Name another folder.",
        ) from error
    return clouds


def read_lines(file: Path) -> list[bytes]:
    """Return the lines of a file of results; half a line at its end, left by a kill, is cut off."""
    if not file.exists():
        return []
    text = file.read_bytes()
    whole = text[: text.rfind(b"\n") + 1]
    if whole != text:
        os.truncate(file, len(whole))
    return whole.splitlines()


def append_line(file: Path, values: dict[str, Any]) -> None:
    """Write a line that outlives the machine."""
    with file.open("a") as lines:
        lines.write(json.dumps(values) + "\n")
        lines.flush()
        os.fsync(lines.fileno())


def store_cloud(folder: Path, key: str, output: Output) -> None:
    """Write a cloud as float32, whole or not at all."""
    temporary = folder / f"{key}.{os.getpid()}.tmp"
    with temporary.open("wb") as file:
        np.savez(file, points=output.points.astype(np.float32), normals=output.normals.astype(np.float32))
    temporary.replace(folder / f"{key}.npz")


def _frame(clean: CleanCloud) -> tuple[Floats, float]:
    low = clean.points.min(axis=0)
    return low, float(np.linalg.norm(clean.points.max(axis=0) - low))


def digest_of(*arrays: Floats | None) -> str:
    """SHA-256 of arrays."""
    total = hashlib.sha256()
    for array in arrays:
        total.update(b"none" if array is None else np.ascontiguousarray(array, "<f8").tobytes())
    return total.hexdigest()


def key_of(digest: str, identity: dict[str, str]) -> str:
    """Return the key of a method's result on an input."""
    text = json.dumps({"input": digest, **identity}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:KEY_LENGTH]

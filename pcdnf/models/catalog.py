"""The catalogue of shipped models, read without torch."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import PcdnfError

FORMAT = 1
"""Version of the metadata's layout."""
DEFAULT_MODEL = "pcdnf-lite"
WEIGHTS = Path(__file__).parents[1] / "weights"
KINDS = ("pcdnf", "lite")
"""Kinds of networks: the paper's, and the light one."""


class CheckpointError(PcdnfError):
    """A model that cannot be found, read, trusted or written."""


@dataclass(frozen=True)
class ModelInfo:
    """Facts about a checkpoint.

    Attributes
    ----------
    name, kind, licence, version : str
        ``kind`` is the network: "pcdnf" (the paper's) or "lite".
    sha256 : str
        Of the file, hexadecimal.
    config, recipe, training : dict
        Network configuration, patch recipe, training facts.
    path : Path
    """

    name: str
    kind: str
    sha256: str
    licence: str
    version: str
    path: Path
    config: dict[str, Any] = field(default_factory=dict)
    recipe: dict[str, Any] = field(default_factory=dict)
    training: dict[str, Any] = field(default_factory=dict)


def available_models() -> list[ModelInfo]:
    """List the shipped models, the default first."""
    models = []
    for name, entry in _index().items():
        path = WEIGHTS / entry["file"]
        info = model_info(path, entry["sha256"], _metadata(path))
        assert info.name == name
        models.append(info)
    return sorted(models, key=lambda info: (info.name != DEFAULT_MODEL, info.name))


def _metadata(path: Path) -> dict[str, str]:
    """Metadata of a shipped safetensors file: the length of its header in eight bytes, then JSON."""
    with path.open("rb") as file:
        header = json.loads(file.read(int.from_bytes(file.read(8), "little")))
    metadata: dict[str, str] = header["__metadata__"]
    return metadata


def _index() -> dict[str, dict[str, str]]:
    index: dict[str, dict[str, str]] = json.loads((WEIGHTS / "index.json").read_text())
    return index


def find_model(name: str) -> tuple[Path, str | None]:
    """Find the file of a shipped model, with its pinned SHA-256, or the file of a path.

    Raises
    ------
    CheckpointError
        ``unknown_model``.
    """
    index = _index()
    if name in index:
        return WEIGHTS / index[name]["file"], index[name]["sha256"]
    path = Path(name)
    if path.is_file():
        return path, None
    raise CheckpointError(
        f"There is no model named {name!r}.",
        code="unknown_model",
        hint=f"Use one of {', '.join(index)}, or the path of a .safetensors file.",
    )


def file_sha256(path: Path) -> str:
    """Compute the SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def unreadable(path: Path) -> CheckpointError:
    """Make the error of a file that is no checkpoint."""
    return CheckpointError(
        f"{path.name} is not a checkpoint of this package.",
        code="bad_checkpoint",
        hint="Convert the authors' .pth files with: pcdnf import-weights release.pth -o out.safetensors",
    )


def model_info(path: Path, digest: str, metadata: Mapping[str, str]) -> ModelInfo:
    """Read the facts in a checkpoint's metadata.

    Raises
    ------
    CheckpointError
        ``bad_checkpoint`` or ``later_checkpoint``.
    """
    try:
        if json.loads(metadata["format"]) > FORMAT:
            raise CheckpointError(
                f"{path.name} was written by a newer version of pcdnf.", code="later_checkpoint", hint="Update pcdnf."
            )
        if metadata["kind"] not in KINDS:
            raise unreadable(path)
        tables = {key: json.loads(metadata[key]) for key in ("config", "recipe", "training")}
        texts: dict[str, Any] = {key: metadata[key] for key in ("name", "kind", "licence", "version")}
    except (KeyError, TypeError, ValueError) as error:
        raise unreadable(path) from error
    return ModelInfo(sha256=digest, path=path, **texts, **tables)

"""Checkpoints: safetensors files whose metadata say what the weights are and how to use them.

Metadata keys, all JSON: ``format`` (a version of this layout), ``name``, ``kind`` (which network), ``config``
(its configuration), ``recipe`` (how patches are taken), ``training`` (facts), ``licence``, ``version``.
The shipped ones stand in ``weights/index.json`` with their SHA-256, which is checked on every load.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from . import __version__
from .errors import PcdnfError

FORMAT = 1
DEFAULT_MODEL = "pcdnf-lite"
WEIGHTS = Path(__file__).parent / "weights"
KINDS = ("pcdnf", "lite")


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


def save_checkpoint(
    path: str | os.PathLike[str],
    state: Mapping[str, Tensor],
    *,
    name: str,
    kind: str,
    config: Mapping[str, Any],
    recipe: Mapping[str, Any],
    training: Mapping[str, Any],
    licence: str,
) -> None:
    """Write weights and metadata in one piece: a reader never sees half a file.

    Raises
    ------
    CheckpointError
        ``unwritable_file``.
    """
    metadata = {
        "format": json.dumps(FORMAT),
        "name": name,
        "kind": kind,
        "config": json.dumps(dict(config)),
        "recipe": json.dumps(dict(recipe)),
        "training": json.dumps(dict(training)),
        "licence": licence,
        "version": __version__,
    }
    temporary = f"{os.fspath(path)}.{os.getpid()}.tmp"
    try:
        save_file({key: value.detach().cpu().contiguous() for key, value in state.items()}, temporary, metadata)
        os.replace(temporary, path)
    except (OSError, SafetensorError) as error:
        raise CheckpointError(
            f"{os.fspath(path)} cannot be written.",
            code="unwritable_file",
            hint="Check its name, its folder's permissions and the space left.",
        ) from error
    finally:
        with suppress(OSError):
            Path(temporary).unlink(missing_ok=True)


def load_checkpoint(name_or_path: str | os.PathLike[str]) -> tuple[ModelInfo, dict[str, Tensor]]:
    """Read a shipped model by name or any checkpoint by path.

    Raises
    ------
    CheckpointError
        Unknown name, missing or damaged file, a hash other than the pinned one, or a later format.
    """
    path, pinned = _resolve(os.fspath(name_or_path))
    digest = _sha256(path)
    if pinned is not None and digest != pinned:
        raise CheckpointError(
            f"The weights of {name_or_path} have been altered: their SHA-256 is not the one shipped.",
            code="weights_altered",
            hint="Reinstall the package.",
        )
    try:
        with safe_open(path, framework="pt") as file:
            info = _info(path, digest, file.metadata() or {})
            return info, {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise _unreadable(path) from error


def available_models() -> list[ModelInfo]:
    """The shipped models, the default first."""
    models = []
    for name, entry in _index().items():
        path = WEIGHTS / entry["file"]
        with safe_open(path, framework="pt") as file:
            info = _info(path, entry["sha256"], file.metadata() or {})
        assert info.name == name
        models.append(info)
    return sorted(models, key=lambda info: (info.name != DEFAULT_MODEL, info.name))


def _index() -> dict[str, dict[str, str]]:
    index: dict[str, dict[str, str]] = json.loads((WEIGHTS / "index.json").read_text())
    return index


def _resolve(name: str) -> tuple[Path, str | None]:
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


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _unreadable(path: Path) -> CheckpointError:
    return CheckpointError(
        f"{path.name} is not a checkpoint of this package.",
        code="bad_checkpoint",
        hint="Released .pth files are converted with: pcdnf import-weights release.pth -o out.safetensors",
    )


def _info(path: Path, digest: str, metadata: Mapping[str, str]) -> ModelInfo:
    try:
        if json.loads(metadata["format"]) > FORMAT:
            raise CheckpointError(
                f"{path.name} was written by a later version.", code="later_checkpoint", hint="Update pcdnf."
            )
        if metadata["kind"] not in KINDS:
            raise _unreadable(path)
        tables = {key: json.loads(metadata[key]) for key in ("config", "recipe", "training")}
        texts: dict[str, Any] = {key: metadata[key] for key in ("name", "kind", "licence", "version")}
    except (KeyError, TypeError, ValueError) as error:
        raise _unreadable(path) from error
    return ModelInfo(sha256=digest, path=path, **texts, **tables)

"""Checkpoints: safetensors files whose metadata describe the weights and their use.

Metadata keys, all JSON: ``format`` (a version of this layout), ``name``, ``kind`` (which network), ``config``
(its configuration), ``recipe`` (how patches are taken), ``training`` (facts), ``licence``, ``version``.
``weights/index.json`` lists the shipped models with their SHA-256, which is checked on every load.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from .._version import __version__
from .catalog import FORMAT, CheckpointError, ModelInfo, file_sha256, find_model, model_info, unreadable


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
    """Write weights and metadata atomically: a reader never sees an incomplete file.

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
            hint="Check the name, the folder's permissions and the free disk space.",
        ) from error
    finally:
        with suppress(OSError):
            Path(temporary).unlink(missing_ok=True)


def load_checkpoint(name_or_path: str | os.PathLike[str]) -> tuple[ModelInfo, dict[str, Tensor]]:
    """Read a shipped model by name or any checkpoint by path.

    Raises
    ------
    CheckpointError
        Unknown name, missing or damaged file, a hash that differs from the pinned one, or a newer format.
    """
    path, pinned = find_model(os.fspath(name_or_path))
    digest = file_sha256(path)
    if pinned is not None and digest != pinned:
        raise CheckpointError(
            f"The weights of {name_or_path} have been modified: their SHA-256 differs from the shipped one.",
            code="weights_altered",
            hint="Reinstall the package.",
        )
    try:
        with safe_open(path, framework="pt") as file:
            info = model_info(path, digest, file.metadata() or {})
            return info, {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise unreadable(path) from error

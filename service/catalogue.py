"""The shipped models as the API shows them, read from their metadata; torch stays out of this process."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import as_file, files
from typing import Any

from pydantic import BaseModel, Field
from safetensors import safe_open


class Model(BaseModel):
    """A model that jobs may name."""

    name: str
    kind: str = Field(description="The network: `pcdnf` (the paper's) or `lite`")
    licence: str
    version: str = Field(description="The release that wrote the file")
    sha256: str = Field(description="Of the file of weights, checked on every load")
    recipe: dict[str, Any] = Field(description="How neighbourhoods are taken")
    training: dict[str, Any] = Field(description="Facts about the training")
    default: bool = Field(False, description="Whether jobs that name no model use this one")


@cache
def shipped() -> dict[str, Model]:
    """Return the shipped models by name."""
    weights = files("pcdnf") / "weights"
    models = {}
    for name, entry in json.loads((weights / "index.json").read_text()).items():
        with as_file(weights / entry["file"]) as path, safe_open(path, framework="np") as file:
            metadata = file.metadata()
        models[name] = Model(
            name=name,
            sha256=entry["sha256"],
            **{key: metadata[key] for key in ("kind", "licence", "version")},
            **{key: json.loads(metadata[key]) for key in ("recipe", "training")},
        )
    return models

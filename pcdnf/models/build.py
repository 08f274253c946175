"""Build a network by its kind, with fresh weights or those of a checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from ..geometry.recipe import Recipe
from .catalog import CheckpointError, ModelInfo
from .config import NetworkConfig
from .lite import LiteConfig, PCDNFLite
from .pcdnf import PCDNF


def trained_network(info: ModelInfo, state: Mapping[str, Tensor]) -> tuple[nn.Module, Recipe]:
    """Build the network of a checkpoint with its weights, and the recipe of its patches.

    Raises
    ------
    CheckpointError
        ``bad_checkpoint``: configuration, recipe or weights do not match a network of this version.
    """
    try:
        network = build_network(info.kind, info.config)
        network.load_state_dict(dict(state))
        return network, Recipe(**info.recipe)
    except (TypeError, ValueError, RuntimeError) as error:
        raise CheckpointError(
            f"{info.path.name} does not match any network of this version.",
            code="bad_checkpoint",
            hint="Update pcdnf, or convert the weights again with the installed version.",
        ) from error


def build_network(kind: str, config: Mapping[str, Any]) -> nn.Module:
    """Build a network of ``kind`` with fresh weights, from the configuration in a checkpoint's metadata."""
    if kind == "lite":
        return PCDNFLite(LiteConfig(**config))
    return PCDNF(NetworkConfig(**config))

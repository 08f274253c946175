"""The two networks by kind: configuration, recipe and loss weights each is trained with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torch import Tensor, nn

from .checkpoint import CheckpointError, ModelInfo
from .lite import LiteConfig, PCDNFLite
from .losses import LossWeights
from .network import PCDNF, NetworkConfig
from .patches import Recipe


@dataclass(frozen=True, kw_only=True)
class Defaults:
    """What a training of one kind starts from; ``fewest_neighbours`` where batches vary them."""

    config: NetworkConfig | LiteConfig
    recipe: Recipe
    losses: LossWeights
    batch: int
    learning_rate: float
    fresh_every: int
    fewest_neighbours: int = 0


DEFAULTS = {
    "pcdnf": Defaults(
        config=NetworkConfig(anchor=True),
        recipe=Recipe(kind="ball", points=512, adaptive=9.8, fewest=256, normals="ball"),
        losses=LossWeights(alpha=1.0, ortho=1.0, nearest=2.0, dense_point=10.0, dense_normal=1.0),
        batch=64,
        learning_rate=2e-3,
        fresh_every=128,
    ),
    "lite": Defaults(
        config=LiteConfig(),
        recipe=Recipe(kind="ball", points=256, adaptive=9.8, fewest=48, normals="ball"),
        losses=LossWeights(alpha=1.0, ortho=0.0, nearest=2.0, dense_point=0.0, dense_normal=0.0),
        batch=256,
        learning_rate=3e-3,
        fresh_every=60,
        fewest_neighbours=96,
    ),
}


def trained_network(info: ModelInfo, state: Mapping[str, Tensor]) -> tuple[nn.Module, Recipe]:
    """The network of a checkpoint with its weights, and how its patches are taken.

    Raises
    ------
    CheckpointError
        ``bad_checkpoint``: configuration, recipe or weights are not those of a network of this version.
    """
    try:
        network = build_network(info.kind, info.config)
        network.load_state_dict(dict(state))
        return network, Recipe(**info.recipe)
    except (TypeError, ValueError, RuntimeError) as error:
        raise CheckpointError(
            f"{info.path.name} does not describe a network of this version.",
            code="bad_checkpoint",
            hint="Update pcdnf, or convert the weights again with the version that is installed.",
        ) from error


def build_network(kind: str, config: Mapping[str, Any]) -> nn.Module:
    """A network of ``kind`` with fresh weights, from the configuration in a checkpoint's metadata."""
    if kind == "lite":
        return PCDNFLite(LiteConfig(**config))
    return PCDNF(NetworkConfig(**config))

"""The default configuration, losses and schedule of each kind of network."""

from __future__ import annotations

from dataclasses import dataclass

from ..geometry.recipe import Recipe
from ..models.config import NetworkConfig
from ..models.lite import LiteConfig
from .losses import LossWeights


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

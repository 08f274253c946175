"""The paper's table 5 and the anchor: each variant of the network trained equally and short, then evaluated.

    python experiments/ablations.py FOLDER [--variants full,full-plain,V1-plain,…] [--steps 300] [--device cuda]

V1 is without selector and refinement, V2 without refinement, V3 without the normal branch, V4 without the point
branch; NAME-plain is NAME without the geometric anchor, as in the paper. All start from one seed and see the same
patches in the same order, with the losses of ``pcdnf train`` but those of a branch that is switched off. Evaluated are
crops of held-out generated shapes with Gaussian noise after one pass: chamfer distance x 1e5 of the crop, and RMS of
the normal error in degrees (the paper's "RMSE x 1e-3"). The paper's figures stand beside: longer training, other
passes, other clouds.

A variant that is trained (FOLDER/NAME.safetensors, same steps, batch and seed) is not trained again. Needs the
``train`` extra.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numba
import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import nn

from pcdnf import Denoiser
from pcdnf.inference.device import choose_device
from pcdnf.metrics import chamfer_distance, point_errors
from pcdnf.models.build import build_network
from pcdnf.models.checkpoint import load_checkpoint, save_checkpoint
from pcdnf.models.config import NetworkConfig
from pcdnf.training.defaults import DEFAULTS
from pcdnf.training.loader import TrainingBatches, stream
from pcdnf.training.losses import Batch, LossWeights, joint_loss
from pcdnf.training.shapes import random_shape
from pcdnf.training.trainer import LICENCE, learning_rate

SWITCHED_OFF = {
    "full": {},
    "V1": {"selector": False, "refinement": False},
    "V2": {"refinement": False},
    "V3": {"normal_branch": False},
    "V4": {"point_branch": False},
}
PAPER = {  # table 5: CD x 1e5, RMSE x 1e3 by noise level; "Full" has no anchor
    "V1": {0.25: (0.64, 15.27), 0.5: (0.87, 18.15), 1.0: (1.52, 22.81), 1.5: (2.99, 27.84), 2.5: (7.23, 35.41)},
    "V2": {0.25: (0.62, 13.42), 0.5: (0.81, 16.30), 1.0: (1.33, 21.58), 1.5: (2.88, 26.62), 2.5: (6.46, 34.53)},
    "V3": {0.25: (0.63, None), 0.5: (0.82, None), 1.0: (1.39, None), 1.5: (2.80, None), 2.5: (6.40, None)},
    "V4": {0.25: (None, 10.95), 0.5: (None, 15.18), 1.0: (None, 21.60), 1.5: (None, 26.68), 2.5: (None, 34.58)},
    "full": {0.25: (0.61, 10.97), 0.5: (0.80, 14.78), 1.0: (1.31, 21.38), 1.5: (2.76, 26.04), 2.5: (5.62, 33.32)},
}
TRAINING_SEED = 500_000
"""Of the training clouds; validation and evaluation begin at later ones."""
FIRST_SEED = 4_000_000
"""Of the held-out shapes."""
SHAPE_POINTS = 60_000
FRESH_EVERY = 10
"""Batches after which a process replaces one of its clouds."""
SHOWN_EVERY = 25
"""Steps between two lines."""
RECIPE = DEFAULTS["pcdnf"].recipe

Pair = tuple[float | None, float | None]


@dataclass(frozen=True)
class Variant:
    """One network of the comparison."""

    name: str

    @property
    def config(self) -> NetworkConfig:
        """The paper's network with the variant's parts switched off."""
        base = self.name.removesuffix("-plain")
        return replace(NetworkConfig(anchor=base == self.name), **SWITCHED_OFF[base])

    @property
    def losses(self) -> LossWeights:
        """Those of ``pcdnf train``, without the terms of a branch that is switched off."""
        weights = DEFAULTS["pcdnf"].losses
        if not self.config.normal_branch:
            weights = replace(weights, normal=0.0, ortho=0.0, dense_normal=0.0)
        if not self.config.point_branch:
            weights = replace(weights, point=0.0, nearest=0.0, ortho=0.0, dense_point=0.0)
        return weights


@dataclass
class Trainee:
    """A variant in training."""

    variant: Variant
    network: nn.Module
    optimizer: torch.optim.Optimizer

    @classmethod
    def fresh(cls, variant: Variant, device: str, seed: int) -> Trainee:
        """With the weights that the seed gives."""
        torch.manual_seed(seed)
        network = build_network("pcdnf", asdict(variant.config)).train().to(device)
        return cls(variant, network, torch.optim.AdamW(network.parameters(), weight_decay=1e-4))

    def step(self, batch: Batch, rate: float) -> dict[str, torch.Tensor]:
        """Learn from a batch."""
        self.optimizer.param_groups[0]["lr"] = rate
        with torch.autocast(batch.points.device.type, torch.bfloat16):
            output = self.network(batch.points, batch.normals)
        loss, watched = joint_loss(output, batch, self.variant.losses)
        self.optimizer.zero_grad()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), 3.0)
        if torch.isfinite(norm):
            self.optimizer.step()
        return watched


def train(variants: list[Variant], folder: Path, options: dict[str, int], device: str, workers: int) -> None:
    """Train variants on the same batches, one step each in turn, and save them."""
    trainees = [Trainee.fresh(variant, device, options["seed"]) for variant in variants]
    data = TrainingBatches(
        RECIPE,
        seed=TRAINING_SEED + options["seed"],
        batch=options["batch"],
        pool=64,
        fresh_every=FRESH_EVERY,
        teacher=None,
    )
    began = time.monotonic()
    batches = stream(data, processes=workers, pin=device != "cpu")
    for step, batch in zip(range(options["steps"]), batches, strict=False):
        moved = batch.each(lambda tensor: tensor.to(device, non_blocking=True))
        rate = learning_rate(DEFAULTS["pcdnf"].learning_rate, step / options["steps"])
        losses = [trainee.step(moved, rate)["loss"] for trainee in trainees]
        if (step + 1) % SHOWN_EVERY == 0:
            shown = ", ".join(f"{t.variant.name} {loss:.3f}" for t, loss in zip(trainees, losses, strict=True))
            print(f"step {step + 1} of {options['steps']}, {time.monotonic() - began:.0f} s, loss {shown}", flush=True)
    for trainee in trainees:
        save_checkpoint(
            folder / f"{trainee.variant.name}.safetensors",
            trainee.network.state_dict(),
            name=trainee.variant.name,
            kind="pcdnf",
            config=asdict(trainee.variant.config),
            recipe=RECIPE.as_dict(),
            training=options,
            licence=LICENCE,
        )


def trained(path: Path, options: dict[str, int]) -> bool:
    """Whether a file holds exactly this training."""
    return path.exists() and load_checkpoint(path)[0].training == options


def evaluate(denoisers: list[Denoiser], shape_index: int, level: float, centres: int) -> list[dict[str, float]]:
    """Each network's figures of one pass over a crop of a held-out shape, and of the crop as it was."""
    shape = random_shape(np.random.default_rng(FIRST_SEED + shape_index), SHAPE_POINTS)
    rng = np.random.default_rng(shape_index)
    noisy = shape.points + rng.normal(size=shape.points.shape) * level / 100
    _, crop = cKDTree(shape.points).query(shape.points[rng.integers(SHAPE_POINTS)], centres)
    cloud = denoisers[0].prepare(noisy)
    cloud.order = crop
    clean = shape.points[crop]
    unit = np.sum(np.ptp(clean, axis=0) ** 2) / np.sum(np.ptp(shape.points, axis=0) ** 2)

    def figures(name: str, points: np.ndarray, normals: np.ndarray) -> dict[str, float]:
        errors = point_errors(points, normals, shape.points, shape.normals)
        return {
            f"{name}_cd": chamfer_distance(points, clean) * float(unit),
            f"{name}_p2s": float(errors.surface.mean()),
            f"{name}_rms": float(np.sqrt(np.square(errors.angle).mean())),
        }

    before = figures("noisy", noisy[crop], cloud.normals[crop])
    tiles = [denoiser.denoise_tile(cloud, 0, centres) for denoiser in denoisers]
    return [before | figures("denoised", tile.points, tile.normals) for tile in tiles]


def table(lines: list[dict], variants: list[Variant], levels: list[float]) -> str:
    """Markdown: chamfer distance and RMS of normals, measured here and in the paper."""
    rows = ["| variant | | " + " | ".join(f"{level:g} %" for level in levels) + " |", "|---" * (len(levels) + 2) + "|"]

    def row(name: str, source: str, pairs: list[Pair]) -> None:
        texts = [", ".join("–" if value is None else f"{value:.2f}" for value in pair) for pair in pairs]
        rows.append(f"| {name} | {source} | " + " | ".join(texts) + " |")

    def means(name: str, kind: str) -> list[Pair]:
        chosen = [[line for line in lines if (line["variant"], line["level"]) == (name, level)] for level in levels]
        return [tuple(float(np.mean([line[f"{kind}_{key}"] for line in at])) for key in ("cd", "rms")) for at in chosen]

    row("noisy", "here", means(variants[0].name, "noisy"))
    shown: set[str] = set()
    for variant in variants:
        config, pairs = variant.config, means(variant.name, "denoised")
        here = [(cd if config.point_branch else None, rms if config.normal_branch else None) for cd, rms in pairs]
        row(variant.name, "here", here)
        base = variant.name.removesuffix("-plain")
        if base not in shown:
            row(base, "paper, no anchor", [PAPER[base].get(level, (None, None)) for level in levels])
        shown.add(base)
    return "\n".join(rows) + "\n"


def main() -> None:
    """Train what is missing, evaluate what is missing, write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--variants", default="full,full-plain,V1-plain,V2-plain,V3-plain,V4-plain")
    parser.add_argument("--levels", default="0.25,0.5,1,1.5,2.5")
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--shapes", type=int, default=6)
    parser.add_argument("--centres", type=int, default=1000, help="points of each crop")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1, help="processes that prepare batches")
    arguments = parser.parse_args()
    variants = [Variant(name) for name in arguments.variants.split(",")]
    unknown = [variant.name for variant in variants if variant.name.removesuffix("-plain") not in SWITCHED_OFF]
    if unknown:
        parser.error(f"no variant {unknown[0]}: use {', '.join(SWITCHED_OFF)}, with or without -plain")
    levels = [float(level) for level in arguments.levels.split(",")]
    device = choose_device(arguments.device)
    numba.set_num_threads(arguments.threads)
    torch.set_num_threads(arguments.threads)
    arguments.folder.mkdir(parents=True, exist_ok=True)
    options = {key: getattr(arguments, key) for key in ("steps", "batch", "seed")}
    paths = {variant: arguments.folder / f"{variant.name}.safetensors" for variant in variants}
    missing = [variant for variant in variants if not trained(paths[variant], options)]
    if missing:
        train(missing, arguments.folder, options, device, arguments.workers)
    denoisers = [Denoiser.load(paths[variant], device=device, precision="float32") for variant in variants]
    lines = []
    for shape in range(arguments.shapes):
        for level in levels:
            for variant, figures in zip(variants, evaluate(denoisers, shape, level, arguments.centres), strict=True):
                lines.append({"variant": variant.name, "shape": shape, "level": level} | figures)
        print(f"shape {shape + 1} of {arguments.shapes} evaluated", flush=True)
    (arguments.folder / "results.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    text = table(lines, variants, levels)
    (arguments.folder / "table.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()

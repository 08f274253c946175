"""The paper's table 5 and the anchor: each variant of the network trained equally and short, then evaluated.

    python benchmarks/ablations.py FOLDER [--variants full,V1,V2,V3,V4,full-plain] [--steps 300] [--threads 1]

V1 is without selector and refinement, V2 without refinement, V3 without the normal branch, V4 without the point
branch; NAME-plain is NAME without the geometric anchor, as in the paper. All start from one seed and see the same
patches in the same order, with the losses of ``pcdnf train`` but those of a branch that is switched off. Evaluated are
crops of held-out generated shapes with Gaussian noise after one pass: chamfer distance x 1e5 of the crop, and RMS of
the normal error in degrees (the paper's "RMSE x 1e-3"). The paper's figures stand beside: longer training, other
passes, other clouds.

A variant that is trained (FOLDER/NAME.safetensors, same steps and seed) is not trained again, an evaluation in
FOLDER/results.jsonl not repeated. Needs the ``train`` extra.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numba
import numpy as np
import torch
from scipy.spatial import cKDTree

from pcdnf import Denoiser
from pcdnf.checkpoint import load_checkpoint, save_checkpoint
from pcdnf.losses import LossWeights
from pcdnf.metrics import chamfer_distance, point_errors
from pcdnf.models import DEFAULTS, build_network
from pcdnf.network import NetworkConfig
from pcdnf.shapes import random_shape
from pcdnf.training import LICENCE, learning_rate, total_loss
from pcdnf.training_data import Batch, TrainingCloud, sample_batch

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
POOL, FRESH_EVERY = 6, 25
"""Clouds held at once, and steps after which all are replaced."""

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


def batches(steps: int, size: int, seed: int) -> Iterator[Batch]:
    """The same patches for every variant."""
    clouds: list[TrainingCloud] = []
    for step in range(steps):
        if step % FRESH_EVERY == 0:
            rng = np.random.default_rng((TRAINING_SEED + seed, step))
            clouds = [TrainingCloud(rng, DEFAULTS["pcdnf"].recipe, None) for _ in range(POOL)]
        yield sample_batch(clouds, np.random.default_rng((TRAINING_SEED + seed, step, 1)), size, 4, 0.25)


def train(variant: Variant, path: Path, *, steps: int, size: int, seed: int) -> None:
    """Train a variant and save it."""
    torch.manual_seed(seed)
    defaults = DEFAULTS["pcdnf"]
    network = build_network("pcdnf", asdict(variant.config)).train()
    optimizer = torch.optim.AdamW(network.parameters(), lr=defaults.learning_rate, weight_decay=1e-4)
    began = time.monotonic()
    for step, batch in enumerate(batches(steps, size, seed)):
        for group in optimizer.param_groups:
            group["lr"] = learning_rate(defaults.learning_rate, step / steps)
        with torch.autocast("cpu", torch.bfloat16):
            output = network(batch.points, batch.normals)
        loss, watched = total_loss(output, batch, variant.losses)
        optimizer.zero_grad()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(network.parameters(), 3.0)
        if torch.isfinite(norm):
            optimizer.step()
        if (step + 1) % FRESH_EVERY == 0 or step + 1 == steps:
            shown = ", ".join(f"{key} {value:.4f}" for key, value in watched.items())
            print(f"{variant.name}: step {step + 1} of {steps}, {time.monotonic() - began:.0f} s, {shown}", flush=True)
    save_checkpoint(
        path,
        network.state_dict(),
        name=variant.name,
        kind="pcdnf",
        config=asdict(variant.config),
        recipe=defaults.recipe.as_dict(),
        training={"steps": steps, "batch": size, "seed": seed},
        licence=LICENCE,
    )


def trained(path: Path, *, steps: int, size: int, seed: int) -> bool:
    """Whether a file holds exactly this training."""
    return path.exists() and load_checkpoint(path)[0].training == {"steps": steps, "batch": size, "seed": seed}


def evaluate(denoiser: Denoiser, shape_index: int, level: float, centres: int) -> dict[str, float]:
    """Figures of one pass over a crop of a held-out shape, and of the crop as it was."""
    shape = random_shape(np.random.default_rng(FIRST_SEED + shape_index), SHAPE_POINTS)
    rng = np.random.default_rng(shape_index)
    noisy = shape.points + rng.normal(size=shape.points.shape) * level / 100
    _, crop = cKDTree(shape.points).query(shape.points[rng.integers(SHAPE_POINTS)], centres)
    cloud = denoiser.prepare(noisy)
    cloud.order = crop
    tile = denoiser.denoise_tile(cloud, 0, centres)
    clean = shape.points[crop]
    unit = np.sum(np.ptp(clean, axis=0) ** 2) / np.sum(np.ptp(shape.points, axis=0) ** 2)
    figures = {}
    for name, points, normals in (("noisy", noisy[crop], cloud.normals[crop]), ("denoised", tile.points, tile.normals)):
        errors = point_errors(points, normals, shape.points, shape.normals)
        figures[f"{name}_cd"] = chamfer_distance(points, clean) * float(unit)
        figures[f"{name}_p2s"] = float(errors.surface.mean())
        figures[f"{name}_rms"] = float(np.sqrt(np.square(errors.angle).mean()))
    return figures


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
    parser.add_argument("--variants", default="full,V1,V2,V3,V4,full-plain")
    parser.add_argument("--levels", default="0.25,0.5,1,1.5,2.5")
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--shapes", type=int, default=6)
    parser.add_argument("--centres", type=int, default=1000, help="points of each crop")
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    variants = [Variant(name) for name in arguments.variants.split(",")]
    unknown = [variant.name for variant in variants if variant.name.removesuffix("-plain") not in SWITCHED_OFF]
    if unknown:
        parser.error(f"no variant {unknown[0]}: use {', '.join(SWITCHED_OFF)}, with or without -plain")
    levels = [float(level) for level in arguments.levels.split(",")]
    numba.set_num_threads(arguments.threads)
    torch.set_num_threads(arguments.threads)
    arguments.folder.mkdir(parents=True, exist_ok=True)
    options = {"steps": arguments.steps, "size": arguments.batch, "seed": arguments.seed}
    results = arguments.folder / "results.jsonl"
    known = [json.loads(line) for line in results.read_text().splitlines()] if results.exists() else []
    lines = []
    for variant in variants:
        path = arguments.folder / f"{variant.name}.safetensors"
        if not trained(path, **options):
            train(variant, path, **options)
        denoiser = Denoiser.load(path, device="cpu", precision="float32")
        for shape in range(arguments.shapes):
            for level in levels:
                key = {"weights_sha256": denoiser.info.sha256, "shape": shape, "level": level}
                key |= {"centres": arguments.centres, "variant": variant.name}
                line = next((line for line in known if line.items() >= key.items()), None)
                if line is None:
                    line = key | evaluate(denoiser, shape, level, arguments.centres)
                    with results.open("a") as file:
                        file.write(json.dumps(line) + "\n")
                lines.append(line)
        print(f"{variant.name}: evaluated", flush=True)
    text = table(lines, variants, levels)
    (arguments.folder / "table.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()

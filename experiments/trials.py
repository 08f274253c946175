"""Changes of the light network's losses, tried side by side: each goes on from the shipped weights on the same batches.

    python experiments/trials.py [--steps 300] [--batch 128] [--trials control,coplanar,…]

After the last step each is validated on held-out shapes: mean projection distance and distance to the nearest clean
point (patch radii), normal error (degrees). A trial that helps shows it against ``control``, which trains on as it did.
Needs the ``train`` extra.
"""

from __future__ import annotations

import argparse
import copy
from dataclasses import replace
from typing import Any

import numba
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcdnf.models.build import build_network
from pcdnf.models.checkpoint import load_checkpoint
from pcdnf.models.cpu.folded import fold
from pcdnf.training.defaults import DEFAULTS
from pcdnf.training.loader import TrainingBatches, stream
from pcdnf.training.losses import Batch, joint_loss, normal_loss
from pcdnf.training.trainer import learning_rate
from pcdnf.training.validation import validate, validation_batches

DEFAULTS_LITE = DEFAULTS["lite"]
SEED = 600_000
RATE = 5e-4
TRIALS = {
    "control": "as it was trained",
    "repulsion": "alpha = 0.97, the paper's",
    "no nearest": "without the distance to the nearest clean point",
    "points alone": "without the normal loss",
    "coplanar": "weights supervised by the true distance to the centre's clean tangent plane",
    "distilled": "displacement and normal of pcdnf besides the truth",
}


def loaded(name: str) -> nn.Module:
    """A shipped network."""
    info, state = load_checkpoint(name)
    network = build_network(info.kind, info.config)
    network.load_state_dict(state)
    return network


def loss_of(trial: str, output: Any, batch: Batch, teacher: Any) -> Tensor:
    """The trial's loss."""
    weights = replace(DEFAULTS_LITE.losses, coplanar=float(trial == "coplanar"))
    if trial == "repulsion":
        weights = replace(weights, alpha=0.97)
    elif trial == "no nearest":
        weights = replace(weights, nearest=0.0)
    elif trial == "points alone":
        weights = replace(weights, normal=0.0)
    loss, _ = joint_loss(output, batch, weights)
    if trial == "distilled":
        loss = loss + 50 * (output.displacement - teacher.displacement).norm(dim=-1).mean()
        loss = loss + 5 * normal_loss(output.normal, F.normalize(teacher.normal, dim=-1)).mean()
    return loss


def main() -> None:
    """Train side by side, then validate."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", default=",".join(TRIALS))
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--batch", type=int, default=128)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    numba.set_num_threads(arguments.threads)
    torch.set_num_threads(arguments.threads)
    start, trials = loaded("pcdnf-lite"), arguments.trials.split(",")
    networks = [copy.deepcopy(start) for _ in trials]
    optimizers = [torch.optim.AdamW(network.parameters(), weight_decay=1e-4) for network in networks]
    teacher = fold(loaded("pcdnf"), torch.bfloat16) if "distilled" in trials else None
    recipe = replace(DEFAULTS["pcdnf"].recipe, fewest=DEFAULTS_LITE.recipe.fewest)
    data = TrainingBatches(recipe, seed=SEED, batch=arguments.batch, pool=24, fresh_every=20, teacher=None)
    for step, batch in zip(range(arguments.steps), stream(data, processes=1, pin=False), strict=False):
        taught = teacher(batch.points, batch.normals) if teacher is not None else None
        chosen = torch.cat([torch.zeros(1, dtype=torch.int64), 1 + torch.randperm(511)[:255]])
        narrow = Batch(
            batch.points[:, chosen],
            batch.normals[:, chosen],
            batch.surface,
            batch.clean_points[:, chosen],
            batch.clean_normals[:, chosen],
        )
        for trial, network, optimizer in zip(trials, networks, optimizers, strict=True):
            optimizer.param_groups[0]["lr"] = learning_rate(RATE, step / arguments.steps)
            with torch.autocast("cpu", torch.bfloat16):
                output = network(narrow.points, narrow.normals)
            optimizer.zero_grad()
            loss_of(trial, output, narrow, taught).backward()
            nn.utils.clip_grad_norm_(network.parameters(), 3.0)
            optimizer.step()
        if (step + 1) % 50 == 0:
            print(f"step {step + 1} of {arguments.steps}", flush=True)
    batches = validation_batches("lite", 4096, 16)
    print("| trial | point | nearest | angle | |\n|---|---|---|---|---|")
    for name, network in zip(["shipped", *trials], [start, *networks], strict=True):
        scores = validate(network, batches)
        figures = f"{scores['point']:.4f} | {scores['nearest']:.4f} | {scores['angle']:.2f}"
        print(f"| {name} | {figures} | {TRIALS.get(name, '')} |", flush=True)


if __name__ == "__main__":
    main()

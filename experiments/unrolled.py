"""Two passes trained together, tried against training each by itself.

    python experiments/unrolled.py [--steps 150] [--clouds 16]

All trials go on from the shipped weights of the light network, see the same crops in the same order and the same losses
of their first pass:

``one pass``     that loss alone
``two passes``   and the loss of a second pass over what the first one made, as constants
``unrolled``     the same, with the second pass's gradient flowing through the first

Figures are mean projection distance in first patch radii and normal error in degrees after each of two passes, over
held-out shapes. Needs the ``train`` extra.
"""

from __future__ import annotations

import argparse
import copy
from dataclasses import dataclass, replace

import numba
import numpy as np
import torch
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor, nn
from torch.nn import functional as F
from trials import loaded

from pcdnf.geometry.noise import NoiseEstimate, clean_spacing, normals_reach
from pcdnf.geometry.normals import ball_normals
from pcdnf.geometry.patches import PatchSource
from pcdnf.models.cpu.allocator import keep_freed_memory
from pcdnf.training.dataset import SURFACE_POINTS
from pcdnf.training.defaults import DEFAULTS
from pcdnf.training.losses import Batch, Surface, angle_degrees, joint_loss, point_terms
from pcdnf.training.shapes import random_shape
from pcdnf.training.trainer import learning_rate

LITE = DEFAULTS["lite"]
RATE = 5e-4
LATER = 0.9
"""Radius of the second pass relative to the first's."""
CENTRES = 48
TRIALS = ("one pass", "two passes", "unrolled")
TRAINING_SEED, HELD_OUT_SEED = 800_000, 1_800_000


class Cloud:
    """A shape with Gaussian noise and its patches."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        shape = random_shape(rng, int(rng.uniform(20_000, 60_000)))
        self.clean, self.normals = shape.points, np.float32(shape.normals)
        self.tree = cKDTree(self.clean)
        level = float(np.exp(rng.uniform(*np.log([0.003, 0.01]))))
        self.noisy = self.clean + rng.normal(size=self.clean.shape) * level
        scale = NoiseEstimate(level, clean_spacing(self.tree))
        self.radius = LITE.recipe.adaptive_radius(scale)
        raw = ball_normals(self.noisy, normals_reach(self.radius, scale))
        self.recipe = replace(LITE.recipe, radius=self.radius, adaptive=0.0, fewest=16)
        self.source = PatchSource(self.noisy, raw, self.recipe, diagonal=1.0, seed=seed, workers=1)


@dataclass(frozen=True)
class Crop:
    """Points around one of a cloud: ``rows`` take a first pass, the first ``centres`` of them a second one."""

    cloud: Cloud
    rows: NDArray[np.int64]
    centres: int

    @classmethod
    def random(cls, cloud: Cloud, rng: Generator) -> Crop:
        """Around a random point."""
        distance = np.linalg.norm(cloud.noisy - cloud.noisy[rng.integers(len(cloud.noisy))], axis=1)
        order = np.argsort(distance)
        reach = distance[order[CENTRES - 1]] + 1.2 * LATER * cloud.radius  # 1.2: points that move in
        return cls(cloud, order[distance[order] < reach], CENTRES)


@dataclass(frozen=True)
class Pass:
    """Where points are after a pass, with normals (both (n, 3), in the world), and the loss's input."""

    points: Tensor
    normals: Tensor
    output: object
    batch: Batch


def surface_of(cloud: Cloud, at: Tensor, own: NDArray[np.int64], frames: Tensor, radius: float) -> Surface:
    """The clean surface near the noisy points ``own``, seen from ``at``."""
    _, around = cloud.tree.query(cloud.noisy[own], SURFACE_POINTS)
    turn = frames.transpose(1, 2)
    local = (torch.from_numpy(np.float32(cloud.clean[around])) - at[:, None]) / radius
    return Surface(local @ turn, torch.from_numpy(cloud.normals[around]) @ turn)


def run(network: nn.Module, cloud: Cloud, points: Tensor, normals: Tensor, own: NDArray[np.int64], at: Tensor,
        frames: Tensor, radius: float) -> Pass:  # fmt: skip
    """The network on patches in their frames, and what it makes of the points ``at``."""
    with torch.autocast("cpu", torch.bfloat16):
        output = network(points, normals)
    moved = at + radius * torch.einsum("bi,bij->bj", output.displacement.float(), frames)
    turned = torch.einsum("bi,bij->bj", output.normal.float(), frames)
    surface = surface_of(cloud, at, own, frames, radius)
    return Pass(moved, F.normalize(turned, dim=-1), output, Batch(points, normals, surface, points, normals))


def first_pass(network: nn.Module, crop: Crop) -> Pass:
    """Over all rows of a crop."""
    patches = crop.cloud.source.take(crop.rows)
    at = torch.from_numpy(np.float32(crop.cloud.noisy[crop.rows]))
    points, normals, frames = map(torch.from_numpy, (patches.points, patches.normals, patches.frames))
    return run(network, crop.cloud, points, normals, crop.rows, at, frames, crop.cloud.radius)


def second_pass(network: nn.Module, crop: Crop, before: Pass) -> Pass:
    """Over the centres, their patches taken from the first pass's points; differentiable in those."""
    cloud, radius = crop.cloud, LATER * crop.cloud.radius
    now, turned = before.points.detach().double().numpy(), before.normals.detach().numpy()
    source = PatchSource(now, turned, replace(cloud.recipe, radius=radius), diagonal=1.0, seed=1, workers=1)
    patches = source.take(np.arange(crop.centres))
    index, frames = torch.from_numpy(patches.index), torch.from_numpy(patches.frames)
    index = torch.where(index < 0, index[:, :1], index)
    at, turn = before.points[: crop.centres], frames.transpose(1, 2)
    points = ((before.points[index] - at[:, None]) / radius) @ turn
    normals = before.normals[index] @ turn
    normals = torch.where(normals[..., 2:] < 0, -normals, normals)
    return run(network, cloud, points, normals, crop.rows[: crop.centres], at, frames, radius)


def part(whole: Pass, rows: slice) -> tuple[object, Batch]:
    """Output and batch of some of a pass's points."""
    return (
        type(whole.output)(*(getattr(whole.output, name)[rows] for name in ("displacement", "normal", "weight"))),
        whole.batch.each(lambda tensor: tensor[rows]),
    )


def loss_of(trial: str, network: nn.Module, crop: Crop) -> Tensor:
    """The trial's loss of a crop."""
    alone = trial == "one pass"
    if trial == "two passes":
        with torch.no_grad():
            before = first_pass(network, crop)
    few = Crop(crop.cloud, crop.rows[: crop.centres], crop.centres)
    here = first_pass(network, crop if trial == "unrolled" else few)
    loss, _ = joint_loss(*part(here, slice(crop.centres)), LITE.losses)
    if alone:
        return loss
    second = second_pass(network, crop, here if trial == "unrolled" else before)
    return loss + joint_loss(second.output, second.batch, LITE.losses)[0]


@torch.no_grad()
def scores(network: nn.Module, crops: list[Crop]) -> list[float]:
    """Projection distance and angle after the first pass, then after the second."""
    found = []
    for crop in crops:
        first = first_pass(network, crop)
        second = second_pass(network, crop, first)
        row = []
        for one, radius in ((first, 1.0), (second, LATER)):
            output, batch = part(one, slice(crop.centres))
            terms = point_terms(output.displacement, batch.surface)  # type: ignore[attr-defined]
            row.append(radius * float(terms.projection.mean()))
            row.append(float(angle_degrees(output.normal, terms.normal).mean()))  # type: ignore[attr-defined]
        found.append(row)
    return [float(each) for each in np.mean(found, 0)]


def main() -> None:
    """Train side by side, then validate."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=150)
    parser.add_argument("--clouds", type=int, default=16)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    keep_freed_memory()
    numba.set_num_threads(arguments.threads)
    torch.set_num_threads(arguments.threads)
    rng = np.random.default_rng(0)
    clouds = [Cloud(TRAINING_SEED + number) for number in range(arguments.clouds)]
    held_out = [Cloud(HELD_OUT_SEED + number) for number in range(arguments.clouds)]
    crops = [Crop.random(cloud, rng) for cloud in held_out for _ in range(4)]
    start = loaded("pcdnf-lite")
    networks = [copy.deepcopy(start).train() for _ in TRIALS]
    optimizers = [torch.optim.AdamW(network.parameters(), weight_decay=1e-4) for network in networks]
    for step in range(arguments.steps):
        drawn = [Crop.random(clouds[int(rng.integers(len(clouds)))], rng) for _ in range(2)]
        for trial, network, optimizer in zip(TRIALS, networks, optimizers, strict=True):
            optimizer.param_groups[0]["lr"] = learning_rate(RATE, step / arguments.steps)
            optimizer.zero_grad()
            for crop in drawn:
                loss_of(trial, network, crop).backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(network.parameters(), 3.0)
            optimizer.step()
        if (step + 1) % 25 == 0:
            print(f"step {step + 1} of {arguments.steps}", flush=True)
    print("| trial | point, one pass | angle | point, two passes | angle |\n|---|---|---|---|---|")
    for name, network in zip(["shipped", *TRIALS], [start, *networks], strict=True):
        one, turned, two, turned_again = scores(network.eval(), crops)
        print(f"| {name} | {one:.4f} | {turned:.2f} | {two:.4f} | {turned_again:.2f} |", flush=True)


if __name__ == "__main__":
    main()

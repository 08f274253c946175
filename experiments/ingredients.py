"""What each part of the training is worth to the light network: trained from nothing, equally and short, without it.

    python experiments/ingredients.py [--steps 600] [--batch 128] [--parts data,optimisation]

Clouds of each condition (a kind of noise, something missing, a size, a first pass behind them) are made once and cut
into patches. `data` leaves one condition after another out of the training and validates on held-out clouds of each
condition; `optimisation` changes learning rate, batch, averaging and the share of patches near edges. Figures are the
mean projection distance, 100 x in patch radii, and of `optimisation` the normal error, too. A second seed shows what is
chance. Needs the ``train`` extra.
"""

from __future__ import annotations

import argparse
import copy
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields, replace
from multiprocessing import get_context

import numba
import numpy as np
import torch
from torch import nn

from pcdnf import Denoiser
from pcdnf.models.cpu.allocator import keep_freed_memory
from pcdnf.models.lite import LiteConfig, PCDNFLite
from pcdnf.training.corruption import Corruption
from pcdnf.training.dataset import TrainingCloud, shape_sample
from pcdnf.training.defaults import DEFAULTS
from pcdnf.training.loader import first_pass
from pcdnf.training.losses import Batch, Surface, angle_degrees, joint_loss, point_terms
from pcdnf.training.trainer import learning_rate

LITE = DEFAULTS["lite"]
PLAIN = Corruption(
    points=(50_000, 120_000),
    **{field.name: 0.0 for field in fields(Corruption) if field.name not in ("points", "thin")},
)
CONDITIONS = {
    "plain": PLAIN,
    "Laplace": replace(PLAIN, laplace=1.0),
    "uniform": replace(PLAIN, uniform=1.0),
    "anisotropic": replace(PLAIN, anisotropic=1.0),
    "scanner": replace(PLAIN, scanner=1.0),
    "outliers": replace(PLAIN, outliers=1.0),
    "uneven": replace(PLAIN, uneven=1.0),
    "holes": replace(PLAIN, holes=1.0),
    "thin": replace(PLAIN, thin=True),
    "sparse": replace(PLAIN, points=(6_000, 15_000)),
    "dense": replace(PLAIN, points=(200_000, 500_000)),
    "second pass": PLAIN,
}
PATCHES = 768
"""Of a cloud, half of them near edges where it has any."""
TRAINING_SEED, HELD_OUT_SEED = 700_000, 1_700_000
SECOND = "nothing, a second seed"
CHUNK = 32
"""Patches of one cloud in a batch."""


@dataclass(frozen=True)
class Bank:
    """Patches of one cloud: near edges, and anywhere."""

    edges: Batch
    anywhere: Batch


def make_bank(condition: str, seed: int) -> Bank:
    """Make a cloud of a condition and cut it."""
    keep_freed_memory()
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    ahead = first_pass(Denoiser.load("pcdnf-lite", device="cpu")) if condition == "second pass" else None
    cloud = TrainingCloud(rng, shape_sample(rng, CONDITIONS[condition]), LITE.recipe, ahead)

    def cut(edges: float) -> Batch:
        arrays = cloud.batch(rng, PATCHES // 2, edges)
        points, normals, near, near_normals, clean, clean_normals = (
            torch.from_numpy(np.float32(each)) for each in arrays
        )
        return Batch(points, normals, Surface(near, near_normals), clean, clean_normals)

    return Bank(cut(1.0), cut(0.0))


def together(batches: list[Batch]) -> Batch:
    """One batch of several."""
    surfaces = [batch.surface for batch in batches]
    surface = Surface(torch.cat([each.points for each in surfaces]), torch.cat([each.normals for each in surfaces]))
    names = ("points", "normals", "clean_points", "clean_normals")
    points, normals, *clean = (torch.cat([getattr(batch, name) for batch in batches]) for name in names)
    return Batch(points, normals, surface, *clean)


def draw(banks: list[Bank], rng: np.random.Generator, size: int, edges: float) -> Batch:
    """A random batch, a share of it near edges, with 96 to 256 neighbours a patch."""
    parts = []
    for _ in range(size // CHUNK):
        bank = banks[int(rng.integers(len(banks)))]
        near = int((rng.random(CHUNK) < edges).sum())
        for source, count in ((bank.edges, near), (bank.anywhere, CHUNK - near)):
            rows = torch.from_numpy(rng.integers(PATCHES // 2, size=count))
            parts.append(source.each(lambda tensor, rows=rows: tensor[rows]))  # type: ignore[misc]
    batch = together(parts)
    full = batch.points.shape[1]
    kept = np.r_[0, 1 + rng.permutation(full - 1)[: 32 * int(rng.integers(LITE.fewest_neighbours // 32, 9)) - 1]]
    chosen = torch.from_numpy(kept)
    narrow = (getattr(batch, name)[:, chosen] for name in ("clean_points", "clean_normals"))
    return Batch(batch.points[:, chosen], batch.normals[:, chosen], batch.surface, *narrow)


def train(
    banks: list[Bank], *, steps: int, batch: int, rate: float = LITE.learning_rate, edges: float = 0.25, seed: int = 0
) -> tuple[nn.Module, nn.Module]:
    """Train from the first weights of a seed; the network and its moving average."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    network = PCDNFLite(LiteConfig())
    average = copy.deepcopy(network).eval()
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=1e-4)
    for step in range(steps):
        optimizer.param_groups[0]["lr"] = learning_rate(rate, step / steps)
        given = draw(banks, rng, batch, edges)
        with torch.autocast("cpu", torch.bfloat16):
            output = network(given.points, given.normals)
        optimizer.zero_grad()
        joint_loss(output, given, LITE.losses)[0].backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(network.parameters(), 3.0)
        optimizer.step()
        decay = min(0.99, (1 + step) / (10 + step))
        with torch.no_grad():
            for mean, value in zip(average.state_dict().values(), network.state_dict().values(), strict=True):
                if mean.is_floating_point():
                    mean.lerp_(value, 1 - decay)
    return network.eval(), average


@torch.no_grad()
def scores(network: nn.Module, banks: list[Bank]) -> tuple[float, float]:
    """Mean projection distance, 100 x in patch radii, and normal error in degrees."""
    point, angle = [], []
    for bank in banks:
        for batch in (bank.edges, bank.anywhere):
            output = network(batch.points, batch.normals)
            terms = point_terms(output.displacement, batch.surface)
            point.append(100 * float(terms.projection.mean()))
            angle.append(float(angle_degrees(output.normal, terms.normal).mean()))
    return float(np.mean(point)), float(np.mean(angle))


Banks = dict[str, list[Bank]]


def make_banks(clouds: int, seed: int, processes: int) -> Banks:
    """So many clouds of each condition, four times as many plain ones."""
    names = [name for name in CONDITIONS for _ in range(clouds * (4 if name == "plain" else 1))]
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        made = list(pool.map(make_bank, names, range(seed, seed + len(names))))
    return {name: [bank for given, bank in zip(names, made, strict=True) if given == name] for name in CONDITIONS}


def data(training: Banks, held_out: Banks, steps: int, batch: int) -> Iterator[str]:
    """Rows of a table: what was left out of the training, validated on each condition."""
    yield "| without | " + " | ".join(CONDITIONS) + " |\n" + "|---" * (1 + len(CONDITIONS)) + "|"
    whole: list[float] = []
    for left_out in ["nothing", SECOND, "all but plain", *list(CONDITIONS)[1:]]:
        names = ["plain"] if left_out == "all but plain" else [name for name in CONDITIONS if name != left_out]
        banks = [bank for name in names for bank in training[name]]
        _, network = train(banks, steps=steps, batch=batch, seed=int(left_out == SECOND))
        found = [scores(network, held_out[name])[0] for name in CONDITIONS]
        whole = whole or found
        shown = [
            f"{value:.2f}" if left_out == "nothing" else f"{100 * (value / before - 1):+.0f} %"
            for value, before in zip(found, whole, strict=True)
        ]
        yield f"| {left_out} | " + " | ".join(shown) + " |"


def optimisation(training: Banks, held_out: Banks, steps: int, batch: int) -> Iterator[str]:
    """Rows of a table: how it was trained, validated on all conditions together."""
    banks, validation = ([bank for each in given.values() for bank in each] for given in (training, held_out))
    yield "| training | point | angle | point without averaging |\n|---|---|---|---|"
    trials: dict[str, Callable[[], tuple[nn.Module, nn.Module]]] = {
        "as it is": lambda: train(banks, steps=steps, batch=batch),
        SECOND: lambda: train(banks, steps=steps, batch=batch, seed=1),
        "a third of the learning rate": lambda: train(banks, steps=steps, batch=batch, rate=LITE.learning_rate / 3),
        "three times the learning rate": lambda: train(banks, steps=steps, batch=batch, rate=LITE.learning_rate * 3),
        "half the batch, twice the steps": lambda: train(banks, steps=2 * steps, batch=batch // 2),
        "twice the batch, half the steps": lambda: train(banks, steps=steps // 2, batch=2 * batch),
        "no patches sought near edges": lambda: train(banks, steps=steps, batch=batch, edges=0.0),
        "half of the patches near edges": lambda: train(banks, steps=steps, batch=batch, edges=0.5),
    }
    for name, trial in trials.items():
        network, average = trial()
        (point, angle), (raw, _) = scores(average, validation), scores(network, validation)
        yield f"| {name} | {point:.3f} | {angle:.2f} | {raw:.3f} |"


def main() -> None:
    """Make the clouds, train, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", default="data,optimisation")
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--batch", type=int, default=128)
    parser.add_argument("--clouds", type=int, default=5, help="of each condition; plain ones four times as many")
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    keep_freed_memory()
    numba.set_num_threads(1)
    torch.set_num_threads(arguments.threads)
    training = make_banks(arguments.clouds, TRAINING_SEED, arguments.threads)
    held_out = make_banks(max(1, arguments.clouds // 2), HELD_OUT_SEED, arguments.threads)
    for part in arguments.parts.split(","):
        for row in {"data": data, "optimisation": optimisation}[part](
            training, held_out, arguments.steps, arguments.batch
        ):
            print(row, flush=True)


if __name__ == "__main__":
    main()

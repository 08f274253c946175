"""Training of both networks: ``pcdnf train``.

The schedule runs over wall time, not steps: a training told to take an hour takes an hour on any machine. Everything
lives in one folder: ``state.safetensors`` (weights, averages, optimiser; the run goes on from there),
``model.safetensors`` (best exponential moving average by validation on held-out shapes) and ``log.jsonl``.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from .checkpoint import save_checkpoint
from .denoiser import Denoiser
from .losses import LossWeights, angle_degrees, normal_loss, ortho_loss, point_terms
from .memory import keep_freed_memory
from .models import DEFAULTS, Defaults, build_network
from .patches import PatchSource, Recipe
from .training_data import Batch, BatchStream, FirstPass, TrainingCloud, sample_batch

WARM_UP = 0.03
"""Share of the budget in which the learning rate rises."""
VALIDATION_SEED = 1_000_000
"""Held-out shapes come from generators seeded here and above; training seeds stay below."""
LICENCE = "MIT"


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of one run.

    Attributes
    ----------
    kind : str
        "pcdnf" or "lite".
    folder : Path
    minutes : float
        Wall time of the whole schedule, earlier sessions of a resumed run included.
    threads : int
        Of torch; data preparation takes about half a thread more.
    save_every : float
        Seconds between validations and saved states.
    first_pass : str or None
        Model whose first iteration prepares a share of the clouds; "self" is the network in training.
    first_pass_share : float
    seed : int
    validation_patches, validation_clouds : int
    pool : int
        Clouds held in memory at once.
    """

    kind: str
    folder: Path
    minutes: float
    threads: int = 1
    save_every: float = 150.0
    first_pass: str | None = None
    first_pass_share: float = 0.4
    seed: int = 0
    validation_patches: int = 2048
    validation_clouds: int = 12
    pool: int = 64


def learning_rate(peak: float, progress: float) -> float:
    """Linear warm-up, then a cosine to zero; ``progress`` runs from 0 to 1."""
    if progress < WARM_UP:
        return peak * progress / WARM_UP
    return peak * 0.5 * (1 + math.cos(math.pi * min(1.0, (progress - WARM_UP) / (1 - WARM_UP)))) + 1e-6


def total_loss(output: Any, batch: Batch, weights: LossWeights) -> tuple[Tensor, dict[str, Tensor]]:
    """The joint loss (equation 5, and our terms) of a batch, with the parts worth watching."""
    terms = point_terms(output.displacement, batch.surface)
    point = weights.alpha * terms.projection + (1 - weights.alpha) * terms.repulsion
    normal = normal_loss(output.normal, terms.normal)
    loss = weights.point * point.mean() + weights.normal * normal.clamp(max=2).mean()
    loss = loss + weights.nearest * terms.nearest.mean()
    if weights.ortho:
        ortho = ortho_loss(output.displacement, output.normal, output.weight, batch.clean_points)
        loss = loss + weights.ortho * ortho.mean()
    if weights.dense_point or weights.dense_normal:
        offset = output.refined_points - batch.clean_points  # (B, M, 3)
        dense = (offset * batch.clean_normals).sum(-1).abs() + 0.02 * offset.square().sum(-1).add(1e-12).sqrt()
        turned = nn.functional.normalize(output.refined_normals, dim=-1)
        loss = loss + weights.dense_point * dense.mean()
        loss = loss + weights.dense_normal * normal_loss(turned, batch.clean_normals).mean()
    watched = {
        "loss": loss,
        "point": terms.projection.mean(),
        "nearest": terms.nearest.mean(),
        "angle": angle_degrees(output.normal, terms.normal).mean(),
    }
    return loss, {key: value.detach() for key, value in watched.items()}


class Trainer:
    """One run; see the module's docstring for its folder."""

    def __init__(self, options: Options) -> None:
        keep_freed_memory()
        numba.set_num_threads(options.threads)
        torch.set_num_threads(options.threads)  # last: Numba's first launch may reset it
        torch.manual_seed(options.seed)
        self.options = options
        self.defaults: Defaults = DEFAULTS[options.kind]
        options.folder.mkdir(parents=True, exist_ok=True)
        self.network = build_network(options.kind, asdict(self.defaults.config))
        self.average = build_network(options.kind, asdict(self.defaults.config)).eval()
        self.average.load_state_dict(self.network.state_dict())
        self.optimizer = torch.optim.AdamW(self.network.parameters(), lr=self.defaults.learning_rate, weight_decay=1e-4)
        self.step, self.elapsed, self.best = 0, 0.0, math.inf
        self._resume()

    @property
    def _state_file(self) -> Path:
        return self.options.folder / "state.safetensors"

    def _resume(self) -> None:
        if not self._state_file.exists():
            return
        with safe_open(self._state_file, framework="pt") as file:
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
            facts = json.loads(file.metadata()["facts"])
        self.step, self.elapsed, self.best = facts["step"], facts["elapsed"], facts["best"]
        self.network.load_state_dict(_part(tensors, "network."))
        self.average.load_state_dict(_part(tensors, "average."))
        for name, parameter in self.network.named_parameters():
            self.optimizer.state[parameter] = {
                "step": torch.tensor(float(self.step)),
                "exp_avg": tensors[f"first.{name}"],
                "exp_avg_sq": tensors[f"second.{name}"],
            }

    def _save_state(self) -> None:
        tensors = {f"network.{key}": value for key, value in self.network.state_dict().items()}
        tensors |= {f"average.{key}": value for key, value in self.average.state_dict().items()}
        for name, parameter in self.network.named_parameters():
            moments = self.optimizer.state[parameter]
            tensors[f"first.{name}"], tensors[f"second.{name}"] = moments["exp_avg"], moments["exp_avg_sq"]
        facts = {"step": self.step, "elapsed": self.elapsed, "best": self.best}
        temporary = self._state_file.with_suffix(".tmp")
        save_file({k: v.contiguous() for k, v in tensors.items()}, temporary, {"facts": json.dumps(facts)})
        temporary.replace(self._state_file)

    def _save_model(self, scores: dict[str, float]) -> None:
        training = {
            "steps": self.step,
            "batch": self.defaults.batch,
            "patches": self.step * self.defaults.batch,
            "hours": round(self.elapsed / 3600, 3),
            "seed": self.options.seed,
            "learning_rate": self.defaults.learning_rate,
            "losses": asdict(self.defaults.losses),
            "first_pass": self.options.first_pass,
            "data": "generated shapes (pcdnf.shapes)",
            "validation": {key: round(value, 5) for key, value in scores.items()},
        }
        save_checkpoint(
            self.options.folder / "model.safetensors",
            self.average.state_dict(),
            name=f"pcdnf-{self.options.kind}".replace("pcdnf-pcdnf", "pcdnf"),
            kind=self.options.kind,
            config=asdict(self.defaults.config),
            recipe=self.defaults.recipe.as_dict(),
            training=training,
            licence=LICENCE,
        )

    def _log(self, **facts: Any) -> None:
        line = json.dumps({"step": self.step, "minutes": round(self.elapsed / 60, 2), **facts})
        print(line, flush=True)
        with (self.options.folder / "log.jsonl").open("a") as log:
            log.write(line + "\n")

    def _update_average(self) -> None:
        decay = min(0.999, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for mean, value in zip(self.average.state_dict().values(), self.network.state_dict().values(), strict=True):
                if mean.is_floating_point():
                    mean.lerp_(value, 1 - decay)
                else:
                    mean.copy_(value)

    def run(self) -> None:
        """Train until the budget is spent; safe to kill and to start again."""
        options, defaults = self.options, self.defaults
        validation = validation_batches(options.kind, options.validation_patches, options.validation_clouds)
        stream = BatchStream(
            defaults.recipe,
            seed=(options.seed + 7919 * self.step) % VALIDATION_SEED,
            batch=defaults.batch,
            pool=options.pool,
            fresh_every=defaults.fresh_every,
        )
        mean: dict[str, float] = {}
        budget, before, last_saved = options.minutes * 60, time.monotonic(), self.elapsed
        while self.elapsed < budget:
            if options.first_pass and stream.first_pass is None and self.elapsed > 0.1 * budget:
                stream.first_pass, stream.first_pass_share = self._first_pass(), options.first_pass_share
            batch = self._narrowed(stream.get())
            for group in self.optimizer.param_groups:
                group["lr"] = learning_rate(defaults.learning_rate, self.elapsed / budget)
            self.network.train()
            with torch.autocast("cpu", torch.bfloat16):
                output = self.network(batch.points, batch.normals)
            loss, watched = total_loss(output, batch, defaults.losses)
            self.optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), 3.0)
            if torch.isfinite(norm):
                self.optimizer.step()
                self._update_average()
            self.step += 1
            now = time.monotonic()
            self.elapsed, before = self.elapsed + now - before, now
            for key, value in watched.items():
                mean[key] = 0.98 * mean.get(key, float(value)) + 0.02 * float(value)
            if self.step % 100 == 0:
                self._log(train={key: round(value, 5) for key, value in mean.items()})
            if self.elapsed - last_saved > options.save_every or self.elapsed >= budget:
                self._checkpoint(validation)
                last_saved = self.elapsed

    def _narrowed(self, batch: Batch) -> Batch:
        """Fewer neighbours a patch, where the network takes any number: a random subset, the same for the batch."""
        fewest = self.defaults.fewest_neighbours
        full = batch.points.shape[1]
        if not fewest:
            return batch
        count = int(torch.randint(fewest // 32, full // 32 + 1, ())) * 32
        chosen = torch.cat([torch.zeros(1, dtype=torch.int64), 1 + torch.randperm(full - 1)[: count - 1]])
        return replace(
            batch,
            points=batch.points[:, chosen],
            normals=batch.normals[:, chosen],
            clean_points=batch.clean_points[:, chosen],
            clean_normals=batch.clean_normals[:, chosen],
        )

    def _checkpoint(self, validation: list[Batch]) -> None:
        scores = validate(self.average, validation)
        self._log(validation={key: round(value, 5) for key, value in scores.items()})
        value = 100 * scores["point"] + 0.1 * scores["angle"]
        if value < self.best:
            self.best = value
            self._save_model(scores)
        self._save_state()

    def _first_pass(self) -> FirstPass:
        name = self.options.first_pass
        assert name is not None
        if name == "self":
            return first_pass(Denoiser(self.average, self.defaults.recipe))
        return first_pass(Denoiser.load(name, device="cpu", precision="float32"))


def first_pass(denoiser: Denoiser) -> FirstPass:
    """One iteration of a crop whose cloud has diagonal 1, as the second iteration will see it."""

    def apply(
        points: NDArray[np.float64],
        normals: NDArray[np.float32],
        recipe: Recipe,
        rows: NDArray[np.int64],
        seed: int,
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        source = PatchSource(points, normals, recipe, diagonal=1.0, seed=seed, workers=1)
        tile = denoiser.inference.denoise(points, normals, source, rows)
        return tile.points, tile.normals

    return apply


def validation_batches(kind: str, patches: int, clouds: int) -> list[Batch]:
    """Fixed patches of held-out shapes, the same for every run of a kind."""
    rng = np.random.default_rng(VALIDATION_SEED)
    pool = [TrainingCloud(rng, DEFAULTS[kind].recipe, None) for _ in range(clouds)]
    size = min(256, patches)
    return [sample_batch(pool, rng, size, 8, 0.25) for _ in range(max(1, patches // size))]


@torch.no_grad()
def validate(network: nn.Module, batches: list[Batch]) -> dict[str, float]:
    """Projection distance (patch radii), distance to the nearest clean point and normal angle (degrees), means."""
    network.eval()
    sums: dict[str, float] = {"point": 0.0, "nearest": 0.0, "angle": 0.0}
    for batch in batches:
        output = network(batch.points, batch.normals)
        terms = point_terms(output.displacement, batch.surface)
        sums["point"] += float(terms.projection.mean())
        sums["nearest"] += float(terms.nearest.mean())
        sums["angle"] += float(angle_degrees(output.normal, terms.normal).mean())
    return {key: value / len(batches) for key, value in sums.items()}


def _part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {key[len(prefix) :]: value for key, value in tensors.items() if key.startswith(prefix)}


def add_train_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of ``pcdnf train``."""
    parser.add_argument("folder", type=Path, help="where the run lives; an interrupted run goes on from there")
    parser.add_argument("--kind", choices=sorted(DEFAULTS), default="lite", help="which network")
    parser.add_argument("--minutes", type=float, default=60.0, help="wall time of the whole schedule")
    parser.add_argument("--threads", type=int, default=1, help="threads of torch")
    parser.add_argument("--first-pass", metavar="MODEL", help="model that prepares a share of the clouds, or 'self'")
    parser.add_argument("--first-pass-share", type=float, default=0.4)
    parser.add_argument("--save-every", type=float, default=150.0, metavar="SECONDS")
    parser.add_argument("--validation-patches", type=int, default=2048)
    parser.add_argument("--validation-clouds", type=int, default=12)
    parser.add_argument("--pool", type=int, default=64, help="training clouds held in memory at once")
    parser.add_argument("--seed", type=int, default=0)


def run(arguments: argparse.Namespace) -> None:
    """Run ``pcdnf train`` with parsed arguments."""
    values = {field.name: getattr(arguments, field.name) for field in fields(Options)}
    Trainer(Options(**values)).run()

"""Training of both networks: ``pcdnf train``.

The schedule runs over wall time, not steps: a training told to take an hour takes an hour on any machine. Everything
lives in one folder: ``state.safetensors`` (weights, averages, optimiser; the run goes on from there),
``model.safetensors`` (best exponential moving average by validation on held-out shapes), at the end
``last.safetensors`` (the last one: validation sees first passes alone) and ``log.jsonl``.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from dataclasses import asdict, fields
from pathlib import Path
from statistics import fmean

import numba
import torch
from torch import Tensor

from ..errors import PcdnfError
from ..geometry.recipe import Recipe
from ..inference.device import choose_device, has_native_bfloat16
from ..models.build import build_network
from ..models.catalog import ModelInfo
from ..models.checkpoint import load_checkpoint, save_checkpoint
from ..models.cpu.allocator import keep_freed_memory
from .defaults import DEFAULTS, Defaults
from .loader import Teacher, TrainingBatches, stream
from .losses import Batch, joint_loss
from .options import Options
from .run_folder import TrainingRun
from .validation import VALIDATION_SEED, scan_batches, validate, validation_batches

WARM_UP = 0.03
"""Share of the budget in which the learning rate rises."""
TEACHER_READY = 0.1
"""Share of the budget after which the network in training is worth being its own teacher."""
LICENCE = "MIT"
SCANS = 18
"""Held-out scans, two of each kind."""
Validation = dict[str, list[Batch]]
"""Fixed patches of held-out shapes and scans."""


def learning_rate(peak: float, progress: float) -> float:
    """Linear warm-up, then a cosine to zero; ``progress`` runs from 0 to 1."""
    if progress < WARM_UP:
        return peak * progress / WARM_UP
    return peak * 0.5 * (1 + math.cos(math.pi * min(1.0, (progress - WARM_UP) / (1 - WARM_UP)))) + 1e-6


class Trainer:
    """One run; see the module's docstring for its folder."""

    def __init__(self, options: Options) -> None:
        keep_freed_memory()
        numba.set_num_threads(options.threads)
        torch.set_num_threads(options.threads)  # last: Numba's first launch may reset it
        torch.manual_seed(options.seed)
        self.options = options
        self.defaults: Defaults = DEFAULTS[options.kind]
        self.device = torch.device(choose_device(options.device))
        self._bfloat16 = has_native_bfloat16(self.device.type)
        self.batch = options.batch or self.defaults.batch
        self.network = build_network(options.kind, asdict(self.defaults.config)).to(self.device)
        self.average = build_network(options.kind, asdict(self.defaults.config)).eval().to(self.device)
        self._started_from = ""
        if options.start is not None:
            info, state = load_checkpoint(options.start)
            _check_kind(info, options.kind)
            self.network.load_state_dict(state)
            self._started_from = info.sha256
        self.average.load_state_dict(self.network.state_dict())
        self.learning_rate = options.learning_rate or self.defaults.learning_rate
        self.optimizer = torch.optim.AdamW(self.network.parameters(), lr=self.learning_rate, weight_decay=1e-4)
        self.run_folder = TrainingRun(options.folder, self.network, self.average, self.optimizer)
        self._teacher = self._make_teacher()

    def _make_teacher(self) -> Teacher | None:
        name, ready = self.options.first_pass, torch.zeros(1).share_memory_()  # type: ignore[no-untyped-call]
        if name is None:
            return None
        if name == "self":
            network, recipe = build_network(self.options.kind, asdict(self.defaults.config)), self.defaults.recipe
            if self.options.start is not None:
                network.load_state_dict(self.average.state_dict())
                ready.fill_(1)
        else:
            info, state = load_checkpoint(name)
            network, recipe = build_network(info.kind, info.config), Recipe(**info.recipe)
            network.load_state_dict(state)
            ready.fill_(1)
        return Teacher(network.eval().share_memory(), recipe, ready, self.options.first_pass_share)

    def run(self) -> None:
        """Train until the budget is spent; safe to kill and to start again."""
        options, run = self.options, self.run_folder
        validation = self._validation()
        batches = stream(self._batches(), processes=self._workers(), pin=self.device.type == "cuda")
        batch = next(batches)  # once the processes stand
        mean: dict[str, Tensor] = {}
        budget, before, last_saved = options.minutes * 60, time.monotonic(), run.elapsed
        while run.elapsed < budget:
            watched = self._step(self._narrowed(batch.each(self._moved)), run.elapsed / budget)
            run.step += 1
            for key, value in watched.items():
                mean[key] = mean.get(key, value).lerp(value, 0.02)
            batch = next(batches)
            now = time.monotonic()
            run.elapsed, before = run.elapsed + now - before, now
            if run.step % 100 == 0:
                run.log(train={key: round(value.item(), 5) for key, value in mean.items()})
            if run.elapsed - last_saved > options.save_every or run.elapsed >= budget:
                self._checkpoint(validation)
                last_saved = run.elapsed
        self._save_model(run.last_file, self._scores(validation))

    def _validation(self) -> Validation:
        """Patches of held-out shapes, and of held-out scans where there are some in the training."""
        options = self.options
        shapes = validation_batches(options.kind, options.validation_patches, options.validation_clouds)
        scans = scan_batches(options.kind, options.validation_patches, SCANS) if options.scans else []
        return {
            name: [batch.each(self._moved) for batch in batches]
            for name, batches in (("shapes", shapes), ("scans", scans))
            if batches
        }

    def _scores(self, validation: Validation) -> dict[str, dict[str, float]]:
        return {name: validate(self.average, batches) for name, batches in validation.items()}

    def _batches(self) -> TrainingBatches:
        return TrainingBatches(
            self.defaults.recipe,
            seed=(self.options.seed + 7919 * self.run_folder.step) % VALIDATION_SEED,
            batch=self.batch,
            pool=self.options.pool,
            fresh_every=max(1, self.defaults.fresh_every * self.defaults.batch // self.batch),
            teacher=self._teacher,
            scans=self.options.scans,
        )

    def _workers(self) -> int:
        if self.options.workers is not None:
            return self.options.workers
        return 1 if self.device.type == "cpu" else max(1, len(os.sched_getaffinity(0)) - 1)

    def _moved(self, tensor: Tensor) -> Tensor:
        return tensor.to(self.device, non_blocking=True)

    def _step(self, batch: Batch, progress: float) -> dict[str, Tensor]:
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate(self.learning_rate, progress)
        self.network.train()
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self._bfloat16):
            output = self.network(batch.points, batch.normals)
        loss, watched = joint_loss(output, batch, self.defaults.losses)
        self.optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), 3.0)
        if torch.isfinite(norm):
            self.optimizer.step()
            self._update_average()
        return watched

    def _update_average(self) -> None:
        decay = min(0.999, (1 + self.run_folder.step) / (10 + self.run_folder.step))
        with torch.no_grad():
            for mean, value in zip(self.average.state_dict().values(), self.network.state_dict().values(), strict=True):
                if mean.is_floating_point():
                    mean.lerp_(value, 1 - decay)
                else:
                    mean.copy_(value)

    def _narrowed(self, batch: Batch) -> Batch:
        """Fewer neighbours a patch, where the network takes any number: a random subset, the same for the batch."""
        fewest = self.defaults.fewest_neighbours
        full = batch.points.shape[1]
        if not fewest:
            return batch
        count = int(torch.randint(fewest // 32, full // 32 + 1, ())) * 32
        chosen = torch.cat([torch.zeros(1, dtype=torch.int64), 1 + torch.randperm(full - 1)[: count - 1]])
        chosen = self._moved(chosen)
        return Batch(
            batch.points[:, chosen],
            batch.normals[:, chosen],
            batch.surface,
            batch.clean_points[:, chosen],
            batch.clean_normals[:, chosen],
        )

    def _checkpoint(self, validation: Validation) -> None:
        run, scores = self.run_folder, self._scores(validation)
        run.log(validation=_rounded(scores))
        value = fmean(100 * each["point"] + 0.1 * each["angle"] for each in scores.values())
        if value < run.best:
            run.best = value
            self._save_model(run.model_file, scores)
        run.save()
        ahead = self._teacher
        if (
            ahead is not None
            and self.options.first_pass == "self"
            and run.elapsed > TEACHER_READY * self.options.minutes * 60
        ):
            ahead.network.load_state_dict(self.average.state_dict())
            ahead.ready.fill_(1)

    def _save_model(self, file: Path, scores: dict[str, dict[str, float]]) -> None:
        run = self.run_folder
        training = {
            "steps": run.step,
            "batch": self.batch,
            "patches": run.step * self.batch,
            "hours": round(run.elapsed / 3600, 3),
            "device": _device_name(self.device),
            "seed": self.options.seed,
            "learning_rate": self.learning_rate,
            "started_from": self._started_from,
            "losses": asdict(self.defaults.losses),
            "first_pass": self.options.first_pass,
            "data": "generated shapes (pcdnf.training.shapes)",
            "scans": self.options.scans,
            "validation": _rounded(scores),
        }
        save_checkpoint(
            file,
            self.average.state_dict(),
            name="pcdnf" if self.options.kind == "pcdnf" else f"pcdnf-{self.options.kind}",
            kind=self.options.kind,
            config=asdict(self.defaults.config),
            recipe=self.defaults.recipe.as_dict(),
            training=training,
            licence=LICENCE,
        )


def _rounded(scores: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    return {name: {key: round(value, 5) for key, value in each.items()} for name, each in scores.items()}


def _check_kind(info: ModelInfo, kind: str) -> None:
    if info.kind != kind:
        hint = f"Start from a model of that kind, or train with --kind {info.kind}."
        raise PcdnfError(f"{info.name} is not of the kind {kind}.", code="bad_option", hint=hint)


def _device_name(device: torch.device) -> str:
    return torch.cuda.get_device_name(device) if device.type == "cuda" else device.type


def run(arguments: argparse.Namespace) -> None:
    """Run ``pcdnf train`` with parsed arguments."""
    values = {field.name: getattr(arguments, field.name) for field in fields(Options)}
    Trainer(Options(**values)).run()

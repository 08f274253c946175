import json
import math
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pcdnf import Denoiser
from pcdnf.errors import PcdnfError
from pcdnf.geometry.recipe import Recipe
from pcdnf.models.checkpoint import load_checkpoint
from pcdnf.models.lite import LiteConfig, PCDNFLite
from pcdnf.training.dataset import TrainingCloud, sample_batch, shape_sample
from pcdnf.training.defaults import DEFAULTS
from pcdnf.training.loader import first_pass
from pcdnf.training.losses import Batch, joint_loss
from pcdnf.training.options import Options
from pcdnf.training.trainer import Trainer, learning_rate
from pcdnf.training.validation import validate

RECIPE = DEFAULTS["lite"].recipe
BATCH = 64


@pytest.fixture(scope="module")
def clouds() -> list[TrainingCloud]:
    rng = np.random.default_rng(5)
    return [TrainingCloud(rng, shape_sample(rng), RECIPE) for _ in range(2)]


@pytest.fixture(scope="module")
def batch(clouds: list[TrainingCloud]) -> Batch:
    return sample_batch(clouds, np.random.default_rng(0), 64, 2, 0.25)


def test_a_batch_is_patches_with_their_clean_surface(batch: Batch) -> None:
    assert batch.points.shape == batch.normals.shape == batch.clean_points.shape == (64, 256, 3)
    assert torch.equal(batch.points[:, 0], torch.zeros(64, 3))
    assert batch.points.norm(dim=-1).max() <= 1 + 1e-5
    assert batch.normals[..., 2].min() >= 0
    for normals in (batch.surface.normals, batch.clean_normals):
        assert torch.allclose(normals.norm(dim=-1), torch.ones(()), atol=1e-4)
    distance = batch.surface.points.norm(dim=-1).min(1).values  # of the noisy centre to the clean surface
    assert distance.max() <= (batch.points - batch.clean_points).norm(dim=-1)[:, 0].max() + 1e-5


def test_a_first_pass_is_cut_from_the_middle_of_a_crop() -> None:
    seen: list[tuple[int, float]] = []

    def move(
        points: np.ndarray, normals: np.ndarray, recipe: Recipe, rows: np.ndarray, _: int
    ) -> tuple[np.ndarray, np.ndarray]:
        seen.append((len(points), recipe.radius))
        assert 0 < len(rows) < len(points)
        return points[rows] + 1e-3, normals[rows]

    rng = np.random.default_rng(7)
    cloud = TrainingCloud(rng, shape_sample(rng), RECIPE, move)
    (crop, radius), *others = seen
    assert not others
    assert 0 < len(cloud.centres) < len(cloud.noisy) < crop
    later = cloud.batch(np.random.default_rng(0), 8, 0.0)[0]
    assert np.abs(later).max() <= 1  # patches are of the second radius, which is drawn anew
    assert np.linalg.norm(np.ptp(cloud.noisy[cloud.centres], axis=0)) < 20 * radius


def test_first_pass_of_a_denoiser_is_its_first_iteration(clouds: list[TrainingCloud]) -> None:
    denoiser = Denoiser.load("pcdnf-lite", device="cpu")
    points = clouds[0].noisy[:600]
    recipe, rows = replace(RECIPE, radius=0.1, adaptive=0.0), np.arange(0, 600, 3)
    moved, normals = first_pass(denoiser)(points, np.tile(np.float32([0, 0, 1]), (600, 1)), recipe, rows, 3)
    assert moved.shape == (200, 3)
    assert 0 < np.abs(moved - points[rows]).max() <= 0.1
    assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)


def test_every_term_of_the_loss_counts(batch: Batch) -> None:
    torch.manual_seed(0)
    output = PCDNFLite(LiteConfig(width=8))(batch.points, batch.normals)
    weights = DEFAULTS["lite"].losses
    whole, watched = joint_loss(output, batch, weights)
    assert set(watched) == {"loss", "point", "nearest", "angle"}
    assert math.isclose(
        whole.item(),
        (
            joint_loss(output, batch, type(weights)(**(vars(weights) | {"point": 0.0})))[0] + 100 * watched["point"]
        ).item(),
        rel_tol=1e-5,
    )


def test_learning_rate_rises_and_falls_to_nothing() -> None:
    rates = [learning_rate(1.0, progress) for progress in np.linspace(0, 1, 101)]
    assert rates[0] == 0
    assert max(rates) == pytest.approx(1, abs=1e-3)
    assert np.argmax(rates) == 3
    assert rates[-1] < 1e-5


def test_a_training_learns_stops_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcdnf.training.trainer.time", SimpleNamespace(monotonic=count().__next__))  # a step a second

    def options(minutes: float) -> Options:
        return Options(
            kind="lite",
            folder=tmp_path,
            minutes=minutes,
            save_every=2,
            workers=0,
            batch=BATCH,
            validation_patches=BATCH,
            validation_clouds=1,
            pool=1,
        )

    Trainer(options(0.1)).run()
    first = Trainer(options(0.1))
    assert first.run_folder.step > 3
    assert first.run_folder.elapsed >= 6
    Trainer(options(0.25)).run()
    again = Trainer(options(0.25))
    assert again.run_folder.step > first.run_folder.step
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    validations = [line["validation"] for line in lines if "validation" in line]
    assert again.run_folder.best <= first.run_folder.best
    assert len(validations) >= 4
    assert again.average.correct[2].weight.abs().max() > 0  # zero at the start
    denoiser = Denoiser.load(tmp_path / "model.safetensors", device="cpu")
    assert denoiser.info is not None
    assert denoiser.info.training["patches"] == denoiser.info.training["steps"] * BATCH
    info, last = load_checkpoint(tmp_path / "last.safetensors")
    assert info.training["steps"] == again.run_folder.step
    assert all(torch.equal(value, last[key]) for key, value in again.average.state_dict().items())
    for old, new in zip(again.network.parameters(), first.network.parameters(), strict=True):
        assert old.shape == new.shape
    moments = again.optimizer.state[next(again.network.parameters())]
    assert moments["exp_avg_sq"].max() > 0


def test_a_folder_of_another_network_is_refused(tmp_path: Path) -> None:
    options = Options(kind="lite", folder=tmp_path, minutes=1)
    trainer = Trainer(options)
    for parameter in trainer.network.parameters():
        trainer.optimizer.state[parameter] = {name: torch.zeros_like(parameter) for name in ("exp_avg", "exp_avg_sq")}
    trainer.run_folder.save()
    with pytest.raises(PcdnfError, match="another network") as caught:
        Trainer(replace(options, kind="pcdnf"))
    assert "--kind" in str(caught.value.hint)
    assert Trainer(options).run_folder.step == 0


@pytest.mark.parametrize("wrong", [{"batch": 2}, {"batch": 6}, {"batch": -4}, {"validation_patches": 4}])
def test_patches_that_cannot_be_shared_out(tmp_path: Path, wrong: dict[str, int]) -> None:
    with pytest.raises(PcdnfError, match="cannot be") as caught:
        Options(kind="lite", folder=tmp_path, minutes=1, **wrong)  # type: ignore[arg-type]
    assert "multiple of" in str(caught.value.hint)


def test_a_training_on_scans_is_validated_on_scans_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcdnf.training.trainer.SCANS", 2)
    options = Options(
        kind="lite",
        folder=tmp_path,
        minutes=0.02,
        workers=0,
        batch=BATCH,
        validation_patches=BATCH,
        validation_clouds=1,
        pool=1,
        scans=1.0,
    )
    Trainer(options).run()
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    scores = next(line["validation"] for line in lines if "validation" in line)
    assert set(scores) == {"shapes", "scans"}
    assert 0 < scores["scans"]["point"] != scores["shapes"]["point"]
    assert load_checkpoint(tmp_path / "last.safetensors")[0].training["scans"] == 1.0


@pytest.mark.parametrize("share", [-0.1, 1.1, math.nan])
def test_a_share_of_scans_that_cannot_be(tmp_path: Path, share: float) -> None:
    with pytest.raises(PcdnfError, match="--scans cannot be"):
        Options(kind="lite", folder=tmp_path, minutes=1, scans=share)


@pytest.mark.parametrize("rate", [0.0, -1e-3, 1.0, math.nan])
def test_a_learning_rate_that_cannot_be(tmp_path: Path, rate: float) -> None:
    with pytest.raises(PcdnfError, match="--learning-rate cannot be") as caught:
        Options(kind="lite", folder=tmp_path, minutes=1, learning_rate=rate)
    assert "0.001" in str(caught.value.hint)


def test_a_training_starts_from_a_model(tmp_path: Path, batch: Batch) -> None:
    options = Options(
        kind="lite", folder=tmp_path / "run", minutes=1, start="pcdnf-lite", first_pass="self", learning_rate=1e-4
    )
    trainer, (info, state) = Trainer(options), load_checkpoint("pcdnf-lite")
    for network in (trainer.network, trainer.average, trainer._teacher.network):  # type: ignore[union-attr]
        assert all(torch.equal(value, state[key]) for key, value in network.state_dict().items())
    assert trainer._teacher is not None
    assert trainer._teacher.ready.item() == 1
    trainer._step(batch, 0.03)
    assert trainer.optimizer.param_groups[0]["lr"] == pytest.approx(1e-4, rel=0.05)
    trainer._save_model(trainer.run_folder.model_file, {})
    training = load_checkpoint(tmp_path / "run" / "model.safetensors")[0].training
    assert training["started_from"] == info.sha256
    assert training["learning_rate"] == 1e-4
    with pytest.raises(PcdnfError, match="not of the kind pcdnf") as caught:
        Trainer(replace(options, kind="pcdnf", folder=tmp_path / "other"))
    assert "--kind lite" in str(caught.value.hint)


def test_validation_is_of_the_network_as_it_is(batch: Batch) -> None:
    trained = Denoiser.load("pcdnf-lite", device="cpu").inference._network
    scores, fresh = validate(trained, [batch]), validate(PCDNFLite(), [batch])
    assert scores["point"] < fresh["point"]
    assert scores["angle"] < fresh["angle"]


def test_batches_of_the_light_network_vary_in_neighbours(batch: Batch, tmp_path: Path) -> None:
    trainer = Trainer(Options(kind="lite", folder=tmp_path, minutes=0.1))
    counts = {trainer._narrowed(batch).points.shape[1] for _ in range(40)}
    assert counts <= {96, 128, 160, 192, 224, 256}
    assert len(counts) > 3
    narrowed = trainer._narrowed(batch)
    assert torch.equal(narrowed.points[:, 0], batch.points[:, 0])
    own = (narrowed.points[:, :, None] - batch.points[:, None]).abs().sum(-1).min(2).values
    assert own.max() == 0

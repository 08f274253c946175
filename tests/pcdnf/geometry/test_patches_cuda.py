"""The GPU's way of taking patches, run on the CPU: the same torch operations."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pcdnf import Denoiser
from pcdnf.geometry.patches import PatchSource
from pcdnf.geometry.patches_cuda import DevicePatchSource
from pcdnf.geometry.patches_local import LocalPatchSource
from pcdnf.geometry.recipe import Recipe
from pcdnf.inference.tiles import Cloud


def sheet(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    points = np.c_[rng.uniform(-0.4, 0.4, (count, 2)), 0.005 * rng.normal(size=count)]
    points[:, 2] += 0.2 * points[:, 0] ** 2
    return points, np.tile(np.float32([0, 0, 1]), (count, 1))


def sources(count: int, recipe: Recipe, radius: float, seed: int = 0) -> tuple[DevicePatchSource, PatchSource]:
    points, normals = sheet(count)
    recipe = Recipe(**recipe.as_dict() | {"radius": radius})
    here = PatchSource(points, normals, recipe, diagonal=1.0, seed=seed)
    return DevicePatchSource(here, device="cpu"), here


def test_neighbours_are_those_of_the_ball() -> None:
    device, here = sources(4000, Recipe(points=256), 0.06)
    centres = np.arange(0, 4000, 7)
    ours, theirs = device.neighbours(torch.from_numpy(centres)).numpy(), here.neighbours(centres)
    assert np.array_equal(ours[:, 0], centres)
    assert (theirs == -1).any(1).all()  # no ball holds as many as a patch: the sets are equal
    assert np.array_equal(np.sort(ours, 1), np.sort(theirs, 1))
    assert ours.max() > 3900


def test_a_subset_depends_on_seed_and_centre_alone() -> None:
    device, _ = sources(20_000, Recipe(points=64), 0.1)
    points, _ = sheet(20_000)
    own = torch.arange(0, 20_000, 50)
    together = device.neighbours(own)
    assert torch.equal(together[100:150], device.neighbours(own[100:150]))
    distance = np.linalg.norm(points[together.numpy()] - points[own.numpy()][:, None], axis=2)
    assert distance.max() <= 0.1
    assert all(len(set(row)) == 64 for row in together.tolist())
    # Uniform over the ball: the median distance is that of an area, 0.1 / sqrt(2).
    inner = np.abs(points[own.numpy(), :2]).max(1) < 0.3
    assert np.median(distance[inner][:, 1:]) == pytest.approx(0.1 / np.sqrt(2), abs=0.003)
    other, _ = sources(20_000, Recipe(points=64), 0.1, seed=1)
    assert (together == other.neighbours(own)).float().mean() < 0.3


def test_few_candidates_at_a_time_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    device, _ = sources(3000, Recipe(points=64), 0.1)
    whole = device.neighbours(torch.arange(3000))
    monkeypatch.setattr("pcdnf.geometry.patches_cuda.CANDIDATES", 5000)
    assert torch.equal(device.neighbours(torch.arange(3000)), whole)


def test_patches_stand_in_the_same_frames() -> None:
    device, here = sources(4000, Recipe(points=256), 0.06)
    centres = np.arange(0, 4000, 31)
    ours, theirs = device.take(centres), here.take(centres)
    assert ours.points.dtype == ours.normals.dtype == ours.frames.dtype == torch.float32
    assert ours.normals[..., 2].min() >= 0
    normal = np.abs((ours.frames[:, 2].numpy() * theirs.frames[:, 2]).sum(-1))
    assert normal.min() > 1 - 1e-5
    height = [np.sort(np.abs(np.asarray(patches.points)[..., 2]), 1) for patches in (ours, theirs)]
    assert np.allclose(*height, atol=1e-4)


def test_the_same_cloud_comes_out() -> None:
    denoiser = Denoiser.load("pcdnf-lite", device="cpu", precision="float32")
    points, normals = sheet(3000)
    cloud = denoiser.prepare(points, normals)
    assert isinstance(cloud.source, LocalPatchSource)
    device = DevicePatchSource(cloud.source, device="cpu")
    other = Cloud(cloud.points, cloud.normals, cloud.frame, device, cloud.order, cloud.local)
    expected = denoiser.denoise_tile(cloud, 0, 3000)
    result = denoiser.denoise_tile(other, 0, 3000)
    assert np.array_equal(result.flagged, expected.flagged)
    # The axes in the plane of a patch have other signs, which moves points along the surface, hardly across it.
    step = np.abs(expected.points - cloud.points[cloud.order])[:, 2].mean()
    assert np.abs(result.points - expected.points)[:, 2].mean() < 0.02 * step
    assert np.abs((result.normals * expected.normals).sum(1)).mean() > 0.999


def test_any_seed_will_do() -> None:
    centres = torch.arange(0, 3000, 50)
    found = [
        sources(3000, Recipe(points=16), 0.1, seed=seed)[0].neighbours(centres) for seed in (3, 2**64 + 3, 2**64 - 1)
    ]
    assert torch.equal(found[0], found[1])
    assert not torch.equal(found[0], found[2])

import numpy as np
import torch

from pcdnf.geometry.patches import PatchSource
from pcdnf.geometry.patches_cuda import DevicePatchSource
from pcdnf.geometry.patches_local import LocalPatchSource
from pcdnf.geometry.recipe import Recipe

RECIPE = Recipe(points=64, adaptive=9.8)


def sheet(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    points = np.c_[rng.uniform(-0.4, 0.4, (count, 2)), 0.005 * rng.normal(size=count)]
    return points, np.tile(np.float32([0, 0, 1]), (count, 1))


def source(count: int, radius: np.ndarray | float, sided: bool = False) -> LocalPatchSource:
    points, normals = sheet(count)
    noise = np.full(count, 0.05)  # all that is near may belong to the centre's sheet
    radius = np.full(count, 1.0) * radius
    return LocalPatchSource(points, normals, RECIPE, radius=radius, noise=noise, seed=1, sided=sided)


def test_each_patch_is_scaled_by_its_own_radius() -> None:
    radius = np.random.default_rng(1).uniform(0.02, 0.2, 5000)
    local = source(5000, radius)
    rows = np.arange(0, 5000, 11)
    patches = local.take(rows)
    length = np.linalg.norm(patches.points, axis=2).max(1)
    assert (length <= 1 + 1e-6).all()
    assert np.median(length) > 0.85
    assert np.array_equal(local.radii(rows), radius[rows])
    for at in (3, 200):
        alone = local.take(rows[at : at + 1])
        assert np.array_equal(alone.points[0], patches.points[at])


def test_one_radius_gives_the_patches_of_one_radius() -> None:
    points, normals = sheet(3000)
    plain = PatchSource(points, normals, Recipe(points=64, radius=0.03), diagonal=1.0, seed=1)
    rows = np.arange(40)
    ours, theirs = source(3000, 0.03).take(rows), plain.take(rows)
    assert [set(row) for row in ours.index.tolist()] == [set(row) for row in theirs.index.tolist()]
    assert np.array_equal(plain.radii(rows), np.full(40, 0.03))


def test_the_device_takes_the_same_balls() -> None:
    radius = np.random.default_rng(1).uniform(0.01, 0.025, 2000)  # none holds as many as a patch
    local = source(2000, radius)
    device = DevicePatchSource(local, device="cpu")
    rows = np.arange(0, 2000, 7)
    ours, theirs = device.take(rows), local.take(rows)
    assert np.array_equal(np.sort(ours.index.numpy(), 1), np.sort(theirs.index, 1))
    assert torch.linalg.norm(ours.points, dim=2).max() <= 1 + 1e-6
    assert np.array_equal(device.radii(rows), radius[rows])

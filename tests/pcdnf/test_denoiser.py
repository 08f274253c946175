import numpy as np
import pytest
import torch

from pcdnf import Denoiser, Stopped
from pcdnf.denoiser import Plan, iteration_seed
from pcdnf.inference.options import ChoiceError
from pcdnf.inference.unit_frame import CloudError, UnitFrame

MODELS = ["pcdnf-lite", "pcdnf"]


@pytest.fixture(scope="module")
def lite() -> Denoiser:
    return Denoiser.load("pcdnf-lite", device="cpu")


@pytest.fixture(scope="module", params=MODELS)
def denoiser(request: pytest.FixtureRequest) -> Denoiser:
    return Denoiser.load(request.param, device="cpu", precision="float32")


def box(count: int, noise: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points on the surface of a unit cube: noisy, with true normals, and their distance to the surface."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.5, 0.5, (count, 3))
    axis, side = rng.integers(3, size=count), rng.choice([-0.5, 0.5], count)
    points[np.arange(count), axis] = side
    normals = np.zeros((count, 3))
    normals[np.arange(count), axis] = np.sign(side)
    return points + noise * rng.normal(size=points.shape), normals, points


def to_box(points: np.ndarray) -> np.ndarray:
    """Distance of points to the surface of the unit cube."""
    beyond = np.abs(points) - 0.5
    return np.abs(np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(1), 0))


@pytest.mark.parametrize(("model", "count"), [("pcdnf-lite", 2000), ("pcdnf", 320)])
def test_noise_is_removed_and_normals_are_filtered(model: str, count: int) -> None:
    noisy, truth, _ = box(100_000, 0.01)  # enough to fill every patch
    denoiser = Denoiser.load(model, device="cpu")
    cloud = denoiser.prepare(noisy)
    cloud.order = np.random.default_rng(0).permutation(len(noisy))
    some = denoiser.denoise_tile(cloud, 0, count)
    rows = cloud.order[:count]
    assert to_box(some.points).mean() < 0.5 * to_box(noisy[rows]).mean()
    flat = np.sort(np.abs(noisy[rows]), axis=1)[:, 1] < 0.45  # away from the edges
    wrong, raw = (
        np.degrees(np.arccos(np.clip(np.abs((normals[flat] * truth[rows][flat]).sum(1)), 0, 1))).mean()
        for normals in (some.normals, cloud.normals[rows])
    )
    assert wrong < 0.5 * raw
    assert np.allclose(np.linalg.norm(some.normals, axis=1), 1, atol=1e-5)
    assert not some.flagged.any()


def test_a_second_iteration_gets_closer(lite: Denoiser) -> None:
    noisy, _, _ = box(8000, 0.02)
    once, twice = (to_box(lite.denoise(noisy, iterations=n).points).mean() for n in (1, 2))
    assert twice < once < 0.6 * to_box(noisy).mean()


def test_results_do_not_depend_on_tiles_or_batches(denoiser: Denoiser) -> None:
    noisy, _, _ = box(3000, 0.01)
    cloud = denoiser.prepare(noisy, seed=3)
    whole = denoiser.denoise_tile(cloud, 500, 580)
    parts = [denoiser.denoise_tile(cloud, start, stop) for start, stop in ((500, 513), (513, 545), (545, 580))]
    scale = cloud.source.radius.min() * cloud.frame.diagonal
    joined = np.concatenate([part.points for part in parts])
    assert np.abs(joined - whole.points).max() < 1e-5 * scale
    batch, denoiser.batch = denoiser.batch, 7
    try:
        other = denoiser.denoise_tile(cloud, 500, 580)
    finally:
        denoiser.batch = batch
    assert np.abs(other.points - whole.points).max() < 1e-5 * scale
    assert np.abs(other.normals - whole.normals).max() < 1e-4


def test_denoise_is_prepare_and_tiles(lite: Denoiser) -> None:
    noisy, _, _ = box(2500, 0.01)
    result = lite.denoise(noisy, iterations=2, seed=5)
    points, normals, frame = noisy, None, UnitFrame.of(noisy)
    plan = lite.plan(noisy, iterations=2)
    for iteration in range(2):
        cloud = lite.prepare(
            points,
            normals,
            plan=plan,
            iteration=iteration,
            frame=frame,
            seed=iteration_seed(5, iteration),
            came=noisy,
            oriented=False,
        )
        points, normals = np.empty_like(points), np.empty(points.shape, np.float32)
        for start, stop in cloud.tiles(1000):
            tile = lite.denoise_tile(cloud, start, stop)
            points[cloud.order[start:stop]], normals[cloud.order[start:stop]] = tile.points, tile.normals
    assert np.allclose(points, result.points, atol=1e-6)
    assert np.allclose(normals, result.normals, atol=1e-4)


def test_fast_takes_fewer_neighbours_and_hardly_worse_ones(lite: Denoiser) -> None:
    noisy, _, _ = box(20_000, 0.01)
    plan = lite.plan(noisy, iterations=1, fast=True)
    assert Plan.from_json(plan.to_json()) == plan
    usual, fast = (lite.prepare(noisy, plan=chosen) for chosen in (lite.plan(noisy, iterations=1), plan))
    assert fast.source.take(fast.order[:4]).points.shape == (4, 128, 3)
    assert usual.source.take(fast.order[:4]).points.shape == (4, 256, 3)
    assert np.array_equal(fast.source.radius, usual.source.radius)
    some = [lite.denoise_tile(cloud, 4000, 6000) for cloud in (usual, fast)]
    left = [to_box(tile.points).mean() for tile in some]
    assert left[0] != left[1]
    assert left[1] < 1.15 * left[0]
    whole, tile = lite.denoise_tile(fast, 4000, 4100), lite.denoise_tile(fast, 4030, 4060)
    assert np.allclose(whole.points[30:60], tile.points, atol=1e-7)


def test_fast_is_told_and_refused_where_it_was_not_trained(lite: Denoiser) -> None:
    noisy, _, _ = box(600, 0.01)
    assert lite.denoise(noisy, iterations=1, fast=True).metadata["fast"] == "128 neighbours"
    assert "fast" not in lite.denoise(noisy, iterations=1).metadata
    with pytest.raises(ChoiceError, match="no fast mode"):
        Denoiser.load("pcdnf", device="cpu").denoise(noisy, fast=True)


def test_same_seed_same_result_other_seed_another(lite: Denoiser) -> None:
    noisy, _, _ = box(8000, 0.01)
    plan = lite.plan(noisy, radius=0.3)  # more than a patch's points in each ball
    first, again, other = (
        lite.denoise_tile(lite.prepare(noisy, plan=plan, seed=seed), 0, 300).points for seed in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_geo_referenced_clouds_lose_nothing() -> None:
    lite = Denoiser.load("pcdnf-lite", device="cpu", precision="float32")  # bfloat16 rounds the last digits anew
    noisy, _, _ = box(2500, 0.01)
    place = np.array([448_000.123, 4_480_000.456, 120.0])
    here, there = lite.denoise(noisy * 64), lite.denoise(noisy * 64 + place)
    assert there.points.dtype == np.float64
    assert np.abs(there.points - place - here.points).max() < 1e-4


def test_normals_keep_the_side_of_the_callers(lite: Denoiser) -> None:
    noisy, truth, _ = box(2500, 0.005)
    outward, inward = lite.denoise(noisy, truth), lite.denoise(noisy, -truth)
    assert ((outward.normals * truth).sum(1) >= 0).mean() > 0.99
    assert np.allclose(inward.normals, -outward.normals, atol=1e-5)
    mixed = truth.copy()
    mixed[::7] = 0
    assert np.isfinite(lite.denoise(noisy, mixed).normals).all()


def test_isolated_points_come_back_as_they_were(lite: Denoiser) -> None:
    noisy, _, _ = box(2500, 0.005)
    noisy[17] = [3.0, 3.0, 3.0]
    result = lite.denoise(noisy)
    assert result.flagged.nonzero()[0].tolist() == [17]
    assert np.array_equal(result.points[17], noisy[17])


@pytest.mark.parametrize(
    "points",
    [
        np.stack([np.linspace(0, 1, 60), np.zeros(60), np.zeros(60)], 1),
        np.c_[np.random.default_rng(0).uniform(size=(64, 2)), np.zeros(64)],
        np.repeat(np.random.default_rng(0).uniform(size=(12, 3)), 6, axis=0),
    ],
    ids=["collinear", "coplanar", "duplicates"],
)
def test_degenerate_clouds_give_finite_results(denoiser: Denoiser, points: np.ndarray) -> None:
    result = denoiser.denoise(points)
    assert np.isfinite(result.points).all()
    assert np.isfinite(result.normals).all()
    assert np.abs(result.points - points).max() < 1.0  # a patch radius at most


def test_too_few_points_and_other_bad_clouds(lite: Denoiser) -> None:
    fewest = lite.minimum_points
    cloud = np.random.default_rng(0).normal(size=(fewest, 3))
    assert len(lite.denoise(cloud).points) == fewest
    with pytest.raises(CloudError, match=f"needs at least {fewest}") as caught:
        lite.denoise(cloud[:-1])
    assert caught.value.code == "too_few_points"
    with pytest.raises(CloudError, match="All points of the cloud are identical"):
        lite.denoise(np.ones((100, 3)))


@pytest.mark.parametrize("shape", [(0,), (90,), (90, 2), (90, 4), (3, 90), (9, 90, 3)])
def test_points_of_other_shapes(lite: Denoiser, shape: tuple[int, ...]) -> None:
    for work in (lite.denoise, lite.plan, lite.prepare):
        with pytest.raises(CloudError, match="Points must be an array") as caught:
            work(np.zeros(shape))
        assert caught.value.code == "bad_shape"


@pytest.mark.parametrize("normals", [np.ones((5, 3)), np.ones((95, 3)), np.ones((1, 3)), np.ones((90, 2)), np.ones(3)])
def test_normals_of_other_shapes(lite: Denoiser, normals: np.ndarray) -> None:
    noisy, _, _ = box(90, 0.01)
    for work in (lite.denoise, lite.prepare):
        with pytest.raises(CloudError, match="ormals") as caught:
            work(noisy, normals)
        assert caught.value.code == "bad_shape"


def test_raw_normals_of_another_name(lite: Denoiser) -> None:
    noisy, _, _ = box(90, 0.01)
    for work in (lite.denoise, lite.prepare):
        with pytest.raises(ChoiceError, match="'PCA'"):
            work(noisy, initial="PCA")


def test_progress_counts_points_times_iterations_and_stop_stops(lite: Denoiser) -> None:
    noisy, _, _ = box(2000, 0.01)
    seen: list[tuple[int, int]] = []
    lite.denoise(noisy, iterations=2, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (4000, 4000)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    with pytest.raises(Stopped):
        lite.denoise(noisy, should_stop=lambda: True)


def test_network_takes_patches_in_their_frame(denoiser: Denoiser) -> None:
    count = denoiser.recipe.points
    points = torch.randn(3, count, 3, generator=torch.Generator().manual_seed(0)) * 0.3
    points[:, 0] = 0
    output = denoiser.network(points, torch.nn.functional.normalize(points + 1, dim=-1))
    assert output.displacement.shape == output.normal.shape == (3, 3)
    assert output.weight.shape == (3, count)
    assert output.selected.shape == (3, count // 2)


def test_metadata_is_enough_to_repeat_the_run(lite: Denoiser) -> None:
    noisy, _, _ = box(1000, 0.01)
    facts = lite.denoise(noisy, seed=4, iterations=1, initial="pca").metadata
    assert facts["model"] == "pcdnf-lite"
    assert lite.info is not None
    assert facts["weights_sha256"] == lite.info.sha256
    assert (facts["device"], facts["precision"]) == ("cpu", lite.precision)
    assert (facts["seed"], facts["iterations"], facts["normals"]) == ("4", "1", "pca")

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pcdnf.geometry.patches import PatchSource
from pcdnf.geometry.recipe import Recipe

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(size=(3000, 3)) * [0.8, 0.6, 0.02]
NORMALS = np.tile(np.float32([0, 0, -1]), (3000, 1))
CENTRES = np.arange(0, 3000, 101)
RECIPES = [
    Recipe(kind="ball", points=64, radius=0.1),
    Recipe(kind="knn", points=64, radius=0.1, upward=False),
    Recipe(kind="near-far", points=64, near=24, radius=0.1),
]


def source(recipe: Recipe, points: np.ndarray = POINTS, seed: int = 0) -> PatchSource:
    return PatchSource(points, NORMALS[: len(points)], recipe, diagonal=1.0, seed=seed)


@pytest.mark.parametrize("recipe", RECIPES, ids=lambda recipe: recipe.kind)
def test_patches_start_with_the_centre_and_repeat_nobody(recipe: Recipe) -> None:
    index = source(recipe).neighbours(CENTRES)
    assert index.shape == (len(CENTRES), 64)
    assert np.array_equal(index[:, 0], CENTRES)
    for row in index:
        row = row[row >= 0]
        assert len(set(row)) == len(row)


@pytest.mark.parametrize("recipe", [RECIPES[0], RECIPES[2]], ids=lambda recipe: recipe.kind)
def test_ball_recipes_stay_in_the_ball_and_pad(recipe: Recipe) -> None:
    sparse = POINTS[::40]
    patches = source(recipe, sparse).take(np.arange(len(sparse)))
    assert np.linalg.norm(patches.points, axis=-1).max() <= 1 + 1e-6
    wanted = [len(ball) for ball in cKDTree(sparse).query_ball_point(sparse, 0.1)]
    assert (patches.index >= 0).sum(1).tolist() == np.minimum(wanted, 64).tolist()
    assert np.array_equal(patches.points[patches.index < 0], np.zeros(((patches.index < 0).sum(), 3)))


def test_knn_takes_the_nearest_whatever_the_radius() -> None:
    index = source(RECIPES[1]).neighbours(CENTRES)
    wanted = cKDTree(POINTS).query(POINTS[CENTRES], 64)[1]
    assert np.array_equal(np.sort(index, 1), np.sort(wanted, 1))


def test_near_far_holds_the_nearest_and_others_of_the_ball() -> None:
    index = source(RECIPES[2]).neighbours(CENTRES)
    near = cKDTree(POINTS).query(POINTS[CENTRES], 24)[1]
    for row, wanted in zip(index, near, strict=True):
        assert set(wanted) <= set(row)


def test_subset_follows_the_seed_not_the_batch() -> None:
    recipe = RECIPES[0]
    whole = source(recipe).neighbours(CENTRES)
    assert np.array_equal(whole[4:6], source(recipe).neighbours(CENTRES[4:6]))
    assert not np.array_equal(whole, source(recipe, seed=1).neighbours(CENTRES))


def test_normals_are_turned_up_only_where_the_recipe_says_so() -> None:
    up = source(RECIPES[0]).take(CENTRES)
    raw = source(RECIPES[1]).take(CENTRES)
    assert up.normals[..., 2].min() > 0.9
    world = np.einsum("bmi,bij->bmj", raw.normals, raw.frames)
    assert np.allclose(world, [0, 0, -1], atol=1e-6)


def test_duplicates_of_the_centre_do_not_push_it_out() -> None:
    points = np.concatenate([np.repeat(POINTS[:1], 70, 0), POINTS[1:]])
    points = np.ascontiguousarray(points[:3000])
    for recipe in RECIPES[1:]:
        index = source(recipe, points).neighbours(np.array([69]))
        assert index[0, 0] == 69
        assert len(set(index[0])) == 64


def test_a_sparse_cloud_gets_a_larger_radius() -> None:
    sparse = np.ascontiguousarray(POINTS[::10])
    recipe = Recipe(kind="ball", points=64, radius=0.02, fewest=20)
    patches = source(recipe, sparse)
    inside = [len(ball) for ball in cKDTree(sparse).query_ball_point(sparse, patches.radius)]
    assert 16 <= np.median(inside) <= 24
    assert source(Recipe(kind="ball", points=64, radius=0.5, fewest=20), sparse).radius == 0.5
    assert source(Recipe(kind="ball", points=64, radius=0.02, fewest=10_000), sparse).radius < 1.1

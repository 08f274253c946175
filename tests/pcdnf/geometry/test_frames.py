import numpy as np
import torch

from pcdnf.geometry.frames import local_patches, local_patches_torch, principal_axes

RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(500, 3)) * [1.0, 0.5, 0.05] + 100
NORMALS = RNG.normal(size=(500, 3)).astype(np.float32)
INDEX = np.array([[i, *RNG.choice(500, 40, replace=False)] for i in range(30)])
INDEX[3:6, 20:] = -1


def test_axes_are_those_of_the_covariance() -> None:
    axes = principal_axes(POINTS, INDEX)
    for row, own in zip(INDEX, axes, strict=True):
        patch = POINTS[row[row >= 0]]
        covariance = np.cov(patch.T)
        spread = np.diag(own @ covariance @ own.T)
        assert np.allclose(own @ covariance @ own.T, np.diag(spread), atol=1e-12)
        assert spread[0] >= spread[1] >= spread[2]
        assert np.allclose(own @ own.T, np.eye(3), atol=1e-12)
        assert np.isclose(np.linalg.det(own), 1)


def test_numba_and_torch_forms_agree() -> None:
    ours = local_patches(POINTS, NORMALS, INDEX, 0.5, upward=True)
    plain = local_patches_torch(
        torch.from_numpy(POINTS), torch.from_numpy(NORMALS), torch.from_numpy(INDEX), 0.5, upward=True
    )
    sign = np.sign((ours[2] * plain[2].numpy()).sum(-1))[:, None]  # (B, 1, 3): the axes' signs are arbitrary
    assert np.allclose(ours[0], plain[0].numpy() * sign, atol=1e-5)
    assert np.allclose(ours[2], plain[2].numpy() * sign.transpose(0, 2, 1), atol=1e-6)


def test_local_coordinates_are_relative_to_the_centre_and_padding_is_the_origin() -> None:
    local, turned, frames = local_patches(POINTS, NORMALS, INDEX, 0.5, upward=True)
    assert np.array_equal(local[:, 0], np.zeros((30, 3)))
    assert np.array_equal(local[3:6, 20:], np.zeros((3, 21, 3)))
    back = np.einsum("bmi,bij->bmj", local, frames) * 0.5 + POINTS[:30, None]
    wanted = POINTS[np.where(INDEX < 0, INDEX[:, :1], INDEX)]
    assert np.abs(back - wanted).max() < 1e-5
    assert (turned[..., 2] >= 0).all()
    assert np.allclose(
        np.linalg.norm(turned, axis=-1),
        np.linalg.norm(NORMALS[np.where(INDEX < 0, INDEX[:, :1], INDEX)], axis=-1),
        rtol=1e-5,
    )


def test_a_patch_is_the_same_in_any_batch() -> None:
    whole = local_patches(POINTS, NORMALS, INDEX, 0.5, upward=True)
    alone = local_patches(POINTS, NORMALS, INDEX[7:8], 0.5, upward=True)
    for a, b in zip(whole, alone, strict=True):
        assert np.array_equal(a[7:8], b)


def test_degenerate_patches_have_a_finite_orthonormal_frame() -> None:
    points = np.stack([np.zeros(20), np.linspace(0, 1, 20), np.zeros(20)], 1)
    lines = principal_axes(points, np.arange(20)[None])
    same = principal_axes(np.ones((20, 3)), np.arange(20)[None])
    for axes in (lines, same):
        assert np.allclose(axes[0] @ axes[0].T, np.eye(3))


def test_spin_turns_the_frame() -> None:
    spin = np.array([[[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]])
    plain = local_patches(POINTS, NORMALS, INDEX[:1], 0.5, upward=False)
    turned = local_patches(POINTS, NORMALS, INDEX[:1], 0.5, upward=False, spin=spin)
    assert np.allclose(turned[0][..., 0], -plain[0][..., 1], atol=1e-6)
    assert np.allclose(turned[0][..., 1], plain[0][..., 0], atol=1e-6)

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from pcdnf.models.cpu.folded_layers import as_numpy
from pcdnf.models.cpu.kernels import lite as lite_kernels

SLOPE = 0.2


def features(dtype: torch.dtype, seed: int = 0) -> torch.Tensor:
    """(3, 21, 40), their mean far from zero."""
    return (torch.randn(3, 21, 40, generator=torch.Generator().manual_seed(seed)) + 3).to(dtype)


def norm() -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(9)
    return torch.rand(40, generator=generator), torch.randn(40, generator=generator)


@pytest.mark.parametrize(("dtype", "bound"), [(torch.float32, 1e-5), (torch.bfloat16, 2e-2)])
def test_settle(dtype: torch.dtype, bound: float) -> None:
    x, (scale, shift) = features(dtype), norm()
    expected = F.leaky_relu(F.layer_norm(x.float(), (40,), scale, shift), SLOPE)
    valid = torch.ones(3, 21, dtype=torch.bool)
    valid[1, 4:] = False
    context = torch.empty(3, 80)
    lite_kernels.normalise(as_numpy(x), valid.numpy(), scale.numpy(), shift.numpy(), SLOPE, context.numpy())
    assert (x.float() - expected).abs().max() < bound
    kept = expected[1, :4]
    assert torch.allclose(context[1], torch.cat([kept.amax(0), kept.mean(0)]), atol=1e-5)
    assert torch.allclose(context[2], torch.cat([expected[2].amax(0), expected[2].mean(0)]), atol=1e-5)


@pytest.mark.parametrize(("dtype", "bound"), [(torch.float32, 1e-5), (torch.bfloat16, 2e-2)])
def test_add_settle(dtype: torch.dtype, bound: float) -> None:
    x, more, (scale, shift) = features(dtype), features(dtype, 1), norm()
    expected = F.leaky_relu(F.layer_norm(x.float() + more.float(), (40,), scale, shift), SLOPE)
    weight, score = torch.linspace(-1, 1, 40), torch.empty(3, 21)
    lite_kernels.add_normalise(
        as_numpy(x), as_numpy(more), scale.numpy(), shift.numpy(), SLOPE, weight.numpy(), 0.5, score.numpy()
    )
    assert (x.float() - expected).abs().max() < bound
    assert torch.allclose(score, expected @ weight + 0.5, atol=1e-4)


def test_equal_channels_settle_at_the_shift() -> None:
    x, (scale, shift) = torch.full((1, 2, 40), 7.3), norm()
    valid = np.ones((1, 2), bool)
    lite_kernels.normalise(x.numpy(), valid, scale.numpy(), shift.numpy(), SLOPE, np.empty((1, 80), np.float32))
    assert torch.allclose(x, F.leaky_relu(shift, SLOPE).expand(1, 2, 40), atol=1e-2)

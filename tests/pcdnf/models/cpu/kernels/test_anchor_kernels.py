from __future__ import annotations

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import nn

from pcdnf.models.anchor import ANCHOR_FLOOR, ANCHOR_RIDGE, anchor
from pcdnf.models.cpu.folded_layers import as_numpy
from pcdnf.models.cpu.kernels.anchor import first_fit

CHANNELS = 48


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 2e-5), (torch.bfloat16, 2e-2)])
def test_it_is_the_selectors_arithmetic(dtype: torch.dtype, tolerance: float) -> None:
    torch.manual_seed(0)
    first, against, steer = nn.Linear(CHANNELS, 1), nn.Linear(4, CHANNELS), nn.Linear(CHANNELS, 1)
    points = torch.randn(3, 200, 3) * torch.tensor([0.5, 0.5, 0.1])
    points[:, 0] = 0
    points[1, 150:] = 0  # padding
    normals = F.normalize(torch.randn(3, 200, 3) + torch.tensor([0.0, 0.0, 2.0]), dim=-1)
    guides = torch.rand(3, 200, CHANNELS).to(dtype)
    slope_weights = torch.empty(3, 200)
    with torch.no_grad():
        score = torch.sigmoid(first(guides.float())[..., 0])
        expected = guides.float() + against(anchor(points, score).against(points, score, normals))
        first_fit(
            as_numpy(guides), points.numpy(), normals.numpy(), ANCHOR_FLOOR, np.float32(ANCHOR_RIDGE),
            first.weight[0].numpy(), float(first.bias), against.weight.T.contiguous().numpy(), against.bias.numpy(),
            steer.weight[0].numpy(), float(steer.bias), slope_weights.numpy(),
        )  # fmt: skip
        torch.testing.assert_close(guides.float(), expected, rtol=tolerance, atol=tolerance)
        wanted = torch.sigmoid(steer(expected)[..., 0])
    torch.testing.assert_close(slope_weights, wanted, rtol=0, atol=1e-5)

"""The light network for inference on a CPU: the same arithmetic without intermediate results in memory.

Separate threads process chunks of patches. Each linear layer between neighbours' features is one oneDNN product with
packed weights; ``kernels.lite`` holds the steps between the products, with the first layer, whose eleven inputs are
computed there, and the last one, which has two outputs. In bfloat16 features
and the weights of the products are bfloat16; context, scores, residuals and fits stay in float32 or better.
"""

from __future__ import annotations

import copy

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..lite import LEAST, SLOPE, STEER, ContextBlock, LiteOutput, PCDNFLite, corrected, scaled_ridge
from ..quadric import QuadricFit
from .folded_layers import Affine, as_numpy
from .kernels import lite as lite_kernels
from .kernels import quadric as quadric_kernels
from .threads import in_parallel

CHUNK = 64
"""Patches worked on at a time: the products run at full speed, and the features stay in the caches."""


class _Block:
    """Folded first layer of a context block: the neighbours' own part, and the patch's with both biases."""

    def __init__(self, block: ContextBlock, dtype: torch.dtype) -> None:
        self.own = Affine(block.own.weight, None, dtype)
        self.weight, self.bias = block.context.weight, block.context.bias + block.own.bias

    def context(self, context: Tensor) -> Tensor:
        """(B, 2 width) -> (B, width)."""
        return F.linear(context, self.weight, self.bias)


class FoldedLite(nn.Module):
    """A ``PCDNFLite`` on the CPU, for inference only; called like its network.

    Parameters
    ----------
    network : PCDNFLite
        On the CPU; it is left as it is, later changes of its weights have no effect.
    dtype : torch.dtype
        float32 (equal to the network's own inference to 1e-5) or bfloat16.
    """

    def __init__(self, network: PCDNFLite, dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        if dtype not in (torch.float32, torch.bfloat16):
            raise ValueError(f"Fold to float32 or bfloat16; {dtype} has no kernels.")
        self.dtype, self.config = dtype, network.config
        network = copy.deepcopy(network).float().requires_grad_(False)
        state = network.state_dict()
        first = state["embed.0.weight"].T.contiguous()  # (11, width)
        self.inner, self.own = first[:8].numpy(), first[8:].numpy()
        self.first_bias = state["embed.0.bias"].numpy()
        self.embed = Affine(state["embed.2.weight"], state["embed.2.bias"], dtype)
        self.embed_norm = state["embed_norm.weight"].numpy(), state["embed_norm.bias"].numpy()
        self.block, self.score = _Block(network.block, dtype), _Block(network.score, dtype)
        self.block_out = Affine(state["block.out.weight"], state["block.out.bias"], dtype)
        self.block_norm = state["block_norm.weight"].numpy(), state["block_norm.bias"].numpy()
        self.first_score = state["first_score.weight"][0].numpy(), float(state["first_score.bias"])
        self.residual = state["residual.weight"].T.contiguous().numpy(), state["residual.bias"].numpy()
        self.scores = state["score.out.weight"].numpy(), (state["score.out.bias"] - torch.tensor([0, STEER])).numpy()
        self.correct = network.correct
        self.ridge = network.ridge

    @torch.inference_mode()
    def forward(self, points: Tensor, normals: Tensor) -> LiteOutput:
        """As ``PCDNFLite.forward``: points, initial normals (B, M, 3) -> LiteOutput."""
        points, normals = points.float().contiguous(), normals.float().contiguous()
        with torch.autocast("cpu", enabled=False):
            chunks = in_parallel(
                self._chunk, list(zip(torch.split(points, CHUNK), torch.split(normals, CHUNK), strict=True))
            )
            coefficients, corrections, weight = (torch.cat(parts) for parts in zip(*chunks, strict=True))
            return corrected(QuadricFit(coefficients), corrections, weight)

    @torch.inference_mode()
    def _chunk(self, points: Tensor, normals: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Patches (B, M, 3) -> fits (B, 6), corrections (B, 9), weights (B, M)."""
        B, M, _ = points.shape
        p, n = points.numpy(), normals.numpy()
        f, valid = torch.empty(B, M, self.config.width, dtype=self.dtype), torch.empty(B, M, dtype=torch.bool)
        lite_kernels.embed(p, n, self.inner, self.own, self.first_bias, SLOPE, as_numpy(f), valid.numpy())
        f = self._product(self.embed, f)  # (B, M, width)
        context = torch.empty(B, 2 * self.config.width)
        lite_kernels.normalise(as_numpy(f), valid.numpy(), *self.embed_norm, SLOPE, context.numpy())
        hidden = self._product(self.block.own, f)
        lite_kernels.activate(as_numpy(hidden), self.block.context(context).numpy(), SLOPE)
        score = torch.empty(B, M)
        more = self._product(self.block_out, hidden)
        lite_kernels.add_normalise(
            as_numpy(f), as_numpy(more), *self.block_norm, SLOPE, *self.first_score, score.numpy()
        )
        weight = score.sigmoid_().add_(LEAST).mul_(valid)

        lite_kernels.against(as_numpy(f), p, n, weight.numpy(), self.ridge.numpy(), *self.residual, context.numpy())
        hidden = self._product(self.score.own, f)
        scores = torch.empty(2, B, M)
        lite_kernels.scores(as_numpy(hidden), self.score.context(context).numpy(), SLOPE, *self.scores, scores.numpy())
        scores = scores.sigmoid_()
        weight, steer = scores[0].add_(LEAST).mul_(valid), scores[1].mul_(valid)
        corrections = self.correct(context)  # (B, 9)
        ridge = scaled_ridge(self.ridge, corrections)  # (B, 6)
        fits = torch.empty(B, 6)
        quadric_kernels.fit_patches(p, weight.numpy(), n, steer.numpy(), ridge.numpy(), fits.numpy())
        return fits, corrections, weight

    def _product(self, layer: Affine, f: Tensor) -> Tensor:
        """Apply a layer to features (B, M, width)."""
        return layer(f.view(-1, f.shape[2])).view(f.shape)

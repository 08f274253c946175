"""The network for inference: BatchNorm folded into the linear layers, no edges, no unnecessary copies.

``fold`` makes it from a trained ``PCDNF``. On a CPU a batch is processed in small chunks whose features stay in the
caches. Each linear layer is one oneDNN product with packed weights, bias and activation included; ``kernels.pcdnf``
holds the steps between the products. A maximum over points commutes with a monotone activation and with
anything that is the same for the whole patch, so bias, global feature and activation come after it.

In bfloat16 features and weights are bfloat16; geometry, distances, scores and the fit stay float32.
On other devices, and for the ablations of the paper's table 5, the network runs as it is, in inference mode.
"""

from __future__ import annotations

import copy

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..anchor import ANCHOR_FLOOR, ANCHOR_REACH, ANCHOR_RIDGE, STEER
from ..decoder import REGRESSOR_NEIGHBOURS, CoordinateRegressor, NormalRegressor
from ..layers import SLOPE, Conv1x1
from ..pcdnf import PCDNF, MultiscaleFeatureExtractor, NetworkOutput, ShapeAwareSelector
from ..quadric import TERMS, QuadricFit, real_points
from .folded_layers import (
    Affine,
    Edges,
    as_numpy,
    coordinate_graph,
    feature_graph,
    fold_conv,
    pool,
    require,
    scale_shift,
)
from .kernels import anchor as anchor_kernels
from .kernels import pcdnf as pcdnf_kernels
from .kernels import quadric as quadric_kernels
from .threads import in_parallel

CHUNK = 8
"""Patches worked on at a time: their features fill the second-level caches, not the memory."""


class _Extractor:
    """Folded extractor, its head's and the selector's hidden layer as one product."""

    def __init__(self, extractor: MultiscaleFeatureExtractor, guide: nn.Linear, dtype: torch.dtype) -> None:
        self.k1, self.k2, self.k3 = extractor.k1, extractor.k2, extractor.k3
        small, large = extractor.small, extractor.large
        (scale1, shift1), (scale2, shift2) = scale_shift(small.norm), scale_shift(large.norm)
        weights = [small.neighbour.weight, large.neighbour.weight]
        weights += [scale1[:, None] * small.centre.weight, scale2[:, None] * large.centre.weight]
        self.project = Affine(torch.cat(weights), torch.cat([torch.zeros(48), shift1, shift2]), torch.float32)
        self.scales = scale1.numpy(), scale2.numpy()
        self.mix, self.lift = fold_conv(extractor.mix, dtype), fold_conv(extractor.lift, dtype)
        self.feature = Edges(extractor.feature, dtype)
        first, last = extractor.head[0], extractor.head[2]
        assert isinstance(first, nn.Linear)
        assert isinstance(last, nn.Linear)
        both = torch.cat([first.weight, guide.weight]), torch.cat([first.bias, guide.bias])
        self.hidden = Affine(*both, dtype, slope=0.0)
        self.last = last.weight.numpy(), last.bias.numpy()
        self.dtype = dtype

    def __call__(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Compute features (B, M, 128) and hidden (B, M, 128), head and selector, of x (B, M, 3)."""
        B, M, _ = x.shape
        graph = coordinate_graph(x, self.k2)  # (B, M, k2)
        projected = self.project(x.view(B * M, 3)).view(B, M, 96).numpy()
        f = torch.empty(B, M, 48, dtype=self.dtype)
        pcdnf_kernels.edge_conv(projected, 0, 48, graph.numpy(), self.k1, self.scales[0], SLOPE, as_numpy(f), 0)
        pcdnf_kernels.edge_conv(projected, 16, 64, graph.numpy(), self.k2, self.scales[1], SLOPE, as_numpy(f), 16)
        f = self.mix(f.view(B * M, 48))  # (B M, 64)
        f = self.feature(f, feature_graph(f.view(B, M, 64), self.k3))  # (B, M, 64)
        f = self.lift(f.view(B * M, 64))  # (B M, 128)
        return f.view(B, M, 128), self.hidden(f).view(B, M, 128)


class _Anchor:
    """The fits that the decoders correct, and what the selector learns from the first of them."""

    def __init__(self, selector: ShapeAwareSelector) -> None:
        first, against, steer = require(selector.first), require(selector.against), require(selector.steer)
        self.ridge = torch.tensor(ANCHOR_RIDGE)
        self.first = first.weight[0].numpy(), float(first.bias)
        self.against = against.weight.T.contiguous().numpy(), against.bias.numpy()
        self.steer = steer.weight[0].numpy(), float(steer.bias) + STEER

    def refine(self, guides: Tensor, points: Tensor, normals: Tensor) -> Tensor:
        """Add to guides (B, M, 192) in place; points, normals (B, M, 3) -> weights of the normals (B, M)."""
        slope_weights = torch.empty(points.shape[:2])
        anchor_kernels.first_fit(
            *(as_numpy(x) for x in (guides, points, normals)),
            ANCHOR_FLOOR,
            self.ridge.numpy(),
            *self.first,
            *self.against,
            *self.steer,
            slope_weights.numpy(),
        )
        return slope_weights

    def fit(self, points: Tensor, weight: Tensor, normals: Tensor, slope_weights: Tensor) -> QuadricFit:
        """As :func:`pcdnf.models.anchor.anchor`."""
        weight = (weight + ANCHOR_FLOOR).mul_(real_points(points))
        fits, ridge = torch.empty(len(points), TERMS), self.ridge.expand(len(points), TERMS)
        quadric_kernels.fit_patches(*(x.numpy() for x in (points, weight, normals, slope_weights, ridge, fits)))
        return QuadricFit(fits)


class _CoordinateRegressor:
    """Folded coordinate regressor; bias, patch feature and activation follow the maximum over points."""

    def __init__(self, regressor: CoordinateRegressor, dtype: torch.dtype) -> None:
        assert regressor.conv.shared is not None
        scale, shift = scale_shift(regressor.conv.norm)
        self.local = Affine(scale[:, None] * regressor.conv.linear.weight, None, dtype)
        self.shared = Affine(scale[:, None] * regressor.conv.shared.weight, shift, torch.float32)
        self.head = _Head(regressor)

    def __call__(self, f: Tensor, patch: Tensor) -> Tensor:
        """Decode features f (B, K, 256) and patch features (B, 128) to (B, 3)."""
        B, K, C = f.shape
        local = pool(self.local(f.view(B * K, C)).view(B, K, -1))  # (B, 512)
        return torch.tanh(self.head(F.leaky_relu_(local.add_(self.shared(patch)), SLOPE)))


class _NormalRegressor:
    """Folded normal regressor; its first layer takes the concatenation in the point branch's order."""

    def __init__(self, regressor: NormalRegressor, dtype: torch.dtype) -> None:
        scale, shift = scale_shift(regressor.conv.norm)
        normal, point = (scale[:, None] * regressor.conv.linear.weight).chunk(2, 1)
        self.local = Affine(torch.cat([point, normal], 1), None, dtype)
        self.shared = Affine(normal, shift, torch.float32)
        self.squeeze, self.expand = Edges(regressor.squeeze, dtype), Edges(regressor.expand, dtype)
        scale, self.lift_bias = scale_shift(regressor.lift.norm)
        self.lift = Affine(scale[:, None] * regressor.lift.linear.weight, None, dtype)
        self.head = _Head(regressor)

    def __call__(self, f: Tensor, patch: Tensor) -> Tensor:
        """Decode features f (B, K, 256) and patch features (B, 128) to (B, 3)."""
        B, K, C = f.shape
        f = self.local(f.view(B * K, C)).view(B, K, -1)  # (B, K, 128)
        f = F.leaky_relu_(f.add_(self.shared(patch)[:, None].to(f.dtype)), SLOPE)
        g = self.squeeze(f.view(B * K, -1), feature_graph(f, REGRESSOR_NEIGHBOURS))  # (B, K, 64)
        g = self.expand(g.view(B * K, -1), feature_graph(g, REGRESSOR_NEIGHBOURS))  # (B, K, 128)
        pooled = pool(self.lift(g.add_(f).view(B * K, -1)).view(B, K, -1))  # (B, 256)
        return self.head(F.leaky_relu_(pooled.add_(self.lift_bias), SLOPE))


class _Head:
    """The fully connected layers of a regressor, on B rows alone: always float32."""

    def __init__(self, regressor: CoordinateRegressor | NormalRegressor) -> None:
        first, second = regressor.reduce
        assert isinstance(first, Conv1x1)
        assert isinstance(second, Conv1x1)
        self.layers = [fold_conv(first, torch.float32), fold_conv(second, torch.float32)]
        self.layers.append(Affine(regressor.out.weight, regressor.out.bias, torch.float32))

    def __call__(self, f: Tensor) -> Tensor:
        for layer in self.layers:
            f = layer(f)
        return f


class FoldedPCDNF(nn.Module):
    """A whole PCDNF on the CPU, for inference only; made by ``fold`` and called like its network."""

    def __init__(self, network: PCDNF, dtype: torch.dtype) -> None:
        super().__init__()
        self.config, self.dtype = network.config, dtype
        selector, refinement, decoder = require(network.selector), require(network.refinement), network.decoder
        self.points = _Extractor(require(network.point_extractor), require(selector.points), dtype)
        self.normals = _Extractor(require(network.normal_extractor), require(selector.normals), dtype)
        self.angle, self.distance = (
            torch.stack([layer.weight[:, 0], layer.bias]).numpy()
            for layer in (require(selector.angle), selector.distance)
        )
        weight, bias = selector.score.linear.weight, scale_shift(selector.score.norm)
        # The guide kernel concatenates points, normals, angle, distance, as the selector does.
        self.score = Affine(bias[0][:, None] * weight, bias[1], dtype)
        self.anchor = _Anchor(selector) if network.config.anchor else None
        self.augment_points = fold_conv(require(refinement.point), dtype)
        self.augment_normals = fold_conv(require(refinement.normal), dtype)
        self.coordinate = _CoordinateRegressor(require(decoder.coordinate), dtype)
        self.normal = _NormalRegressor(require(decoder.normal), dtype)

    @torch.inference_mode()
    def forward(self, points: Tensor, normals: Tensor) -> NetworkOutput:
        """As ``PCDNF.forward``: points, normals (B, M, 3) -> NetworkOutput, float32."""
        points, normals = points.float().contiguous(), normals.float().contiguous()
        with torch.autocast("cpu", enabled=False):
            chunks = in_parallel(
                self._chunk, list(zip(torch.split(points, CHUNK), torch.split(normals, CHUNK), strict=True))
            )
        return NetworkOutput(*(torch.cat(parts) for parts in zip(*chunks, strict=True)))

    @torch.inference_mode()
    def _chunk(self, points: Tensor, normals: Tensor) -> NetworkOutput:
        B, M, _ = points.shape
        f_p, hidden_p = self.points(points)  # (B, M, 128) each
        f_n, hidden_n = self.normals(normals)

        guides = torch.empty(B, M, 192, dtype=self.dtype)
        refined_points, refined_normals = torch.empty_like(points), torch.empty_like(normals)
        pcdnf_kernels.guide(
            *(as_numpy(x) for x in (points, normals, hidden_p, hidden_n)),
            *self.points.last,
            *self.normals.last,
            self.angle,
            self.distance,
            *(as_numpy(x) for x in (refined_points, refined_normals, guides)),
        )
        steer = self.anchor.refine(guides, points, normals) if self.anchor else None  # (B, M)
        score = self.score(guides.view(B * M, -1)).view(B, M, -1)  # (B, M, 128)
        weight, selected = torch.empty(B, M), torch.zeros(B, self.config.selected, dtype=torch.int32)
        pcdnf_kernels.score(as_numpy(score), SLOPE, weight.numpy(), selected.numpy())
        graph = coordinate_graph(refined_points, self.config.k4, selected)  # (B, K, k4)

        g_p = self.augment_points(self._augment(f_p, weight, selected, graph))  # (B K, 128)
        g_n = self.augment_normals(self._augment(f_n, weight, selected, graph))
        f = torch.cat([g_p, g_n], -1).view(B, -1, 256)  # (B, K, 256)
        displacement, normal = self.coordinate(f, pool(f_p)), self.normal(f, pool(f_n))
        if self.anchor and steer is not None:
            fit = self.anchor.fit(points, weight, normals, steer)
            displacement, normal = fit.displacement() + ANCHOR_REACH * displacement, fit.normal() + normal
        return NetworkOutput(displacement, normal, weight, selected.long(), refined_points, refined_normals)

    def _augment(self, f: Tensor, weight: Tensor, selected: Tensor, graph: Tensor) -> Tensor:
        """Augment features f (B, M, 128) to (B K, 128), before the linear layer."""
        near = f
        if self.config.release_transpose:
            near = (weight[..., None] * f).to(f.dtype).transpose(1, 2).contiguous().view(f.shape)
            weight = torch.ones_like(weight)
        out = torch.empty(*selected.shape, f.shape[2], dtype=f.dtype)
        pcdnf_kernels.augment(
            as_numpy(f), as_numpy(near), *(x.numpy() for x in (weight, selected, graph)), as_numpy(out)
        )
        return out.view(-1, f.shape[2])


class PlainInference(nn.Module):
    """A PCDNF as it is, in inference mode, its products in the given precision."""

    def __init__(self, network: PCDNF, dtype: torch.dtype) -> None:
        super().__init__()
        self.network, self.dtype = network, dtype

    @torch.inference_mode()
    def forward(self, points: Tensor, normals: Tensor) -> NetworkOutput:
        """As ``PCDNF.forward``."""
        with torch.autocast(points.device.type, self.dtype, enabled=self.dtype is not torch.float32):
            output: NetworkOutput = self.network(points, normals)
        return output


def fold(network: PCDNF, dtype: torch.dtype = torch.float32) -> nn.Module:
    """Fold a network for inference, with its present weights.

    Parameters
    ----------
    network : PCDNF
        On the device it is to run on; it is left as it is.
    dtype : torch.dtype
        float32 (equal to the network's own inference to 1e-4) or bfloat16.

    Returns
    -------
    nn.Module
        Called like the network; without gradients.
    """
    if dtype not in (torch.float32, torch.bfloat16):
        raise ValueError(f"Fold to float32 or bfloat16; {dtype} has no kernels.")
    network = copy.deepcopy(network).eval().requires_grad_(False)
    config = network.config
    complete = config.selector and config.refinement and config.point_branch and config.normal_branch
    on_cpu = all(parameter.device.type == "cpu" for parameter in network.parameters())
    return FoldedPCDNF(network, dtype) if complete and on_cpu else PlainInference(network, dtype)

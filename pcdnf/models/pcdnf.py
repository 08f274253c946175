"""PCDNF (Liu et al., TVCG 2023, DOI 10.1109/TVCG.2023.3292464, section 3.2): patches in, displacements out.

Four modules, named as in the paper: multiscale feature extractor, shape-aware selector, feature refinement
(augmentation and fusion), decoder (coordinate and normal regressor). B patches of M points in the patch
frame, K of them selected. Where paper and released code differ, this does what the code does, so that its
weights load.

Deviations, each of them deliberate:

* An EdgeConv never builds its edges, see :mod:`pcdnf.models.layers`.
* ``anchor`` (ours): the selector's scores also weigh a least-squares quadric fit of the patch, whose value
  and slope at the origin are the first guess of displacement and normal; the decoders predict the remainder.
  The patch must be in its PCA frame, least variance along z. The losses then reach the selector directly,
  as remark 1 of the paper wishes. A first fit, with scores from the coarse features, tells the selector how
  far each point lies from the surface; a second score says how far a point's normal may steer the slope.
* ``release_transpose``: a quirk of the released code, needed for its weights alone (``FeatureRefinement``).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .anchor import ANCHOR_REACH, STEER, anchor
from .config import NetworkConfig
from .decoder import Decoder, FusedFeatures
from .layers import Conv1x1, EdgeConv
from .ops.neighbours import gather_mean, gather_points, knn


class Patch(NamedTuple):
    """Points and normals of a batch of patches, (B, M, 3) each."""

    points: Tensor
    normals: Tensor


class NetworkOutput(NamedTuple):
    """Prediction of PCDNF for a batch of patches; a branch that is switched off returns its input."""

    displacement: Tensor  # (B, 3) from the noisy to the denoised centre, patch frame, in radii
    normal: Tensor  # (B, 3) of the centre, patch frame, not normalised
    weight: Tensor  # (B, M) similarity to the centre, 0 to 1
    selected: Tensor  # (B, K) int64, the points of largest weight
    refined_points: Tensor  # (B, M, 3)
    refined_normals: Tensor  # (B, M, 3)


class MultiscaleFeatureExtractor(nn.Module):
    """Coarse features of points or normals (one instance each), and a refined input for every point."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.k1, self.k2, self.k3 = config.k1, config.k2, config.k3
        self.small = EdgeConv(3, 16)
        self.large = EdgeConv(3, 32)
        self.mix = Conv1x1(48, 64)
        self.feature = EdgeConv(64, 64)
        self.lift = Conv1x1(64, 128)
        self.head = nn.Sequential(nn.Linear(128, 64), nn.ReLU(), nn.Linear(64, 3))

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Points or normals x (B, M, 3) to features (B, M, 128) and refined x (B, M, 3)."""
        graph = knn(x, self.k2)  # (B, M, k2)
        f = torch.cat([self.small(x, graph[..., : self.k1]), self.large(x, graph)], -1)  # (B, M, 48)
        f = self.mix(f)  # (B, M, 64)
        f = self.lift(self.feature(f, knn(f, self.k3)))  # (B, M, 128)
        return f, x + self.head(f).float()


class Selection(NamedTuple):
    """Scores of the selector for every point."""

    weight: Tensor  # (B, M) similarity to the centre, 0 to 1
    steer: Tensor | None  # (B, M) weight of the normal in the anchor's fit, relative to the point's


class ShapeAwareSelector(nn.Module):
    """Score of every point: how much it is like the centre (paper, section 3.2.2)."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.points = nn.Linear(128, 64) if config.point_branch else None
        self.normals = nn.Linear(128, 64) if config.normal_branch else None
        self.angle = nn.Linear(1, 32) if config.normal_branch else None
        self.distance = nn.Linear(1, 32)
        channels = 32 + 64 * config.point_branch + 96 * config.normal_branch
        self.first = nn.Linear(channels, 1) if config.anchor else None
        self.against = nn.Linear(3 + config.normal_branch, channels) if config.anchor else None
        self.steer = nn.Linear(channels, 1) if config.anchor and config.normal_branch else None
        self.score = Conv1x1(channels, 128)

    def forward(self, patch: Patch, refined: Patch, f_p: Tensor | None, f_n: Tensor | None) -> Selection:
        """Patch, refined patch and features (B, M, 128) of points and normals to weights (B, M)."""
        points, normals = refined
        guides = []
        if self.points is not None and f_p is not None:
            guides.append(self.points(f_p))
        if self.normals is not None and f_n is not None:
            guides.append(self.normals(f_n))
        if self.angle is not None:
            across = torch.linalg.cross(points, normals, dim=-1).norm(dim=-1, keepdim=True)
            guides.append(self.angle(torch.atan2(across, (points * normals).sum(-1, keepdim=True))))
        guides.append(self.distance(torch.exp(-points.square().sum(-1, keepdim=True))))
        guide, steer = F.relu(torch.cat(guides, -1)), None  # (B, M, channels)
        if self.first is not None and self.against is not None:
            first = torch.sigmoid(self.first(guide).float()[..., 0])  # (B, M)
            known = None if self.angle is None else patch.normals
            guide = guide + self.against(anchor(patch.points, first).against(patch.points, first, known))
        if self.steer is not None:
            steer = torch.sigmoid(self.steer(guide).float()[..., 0] + STEER)
        return Selection(torch.sigmoid(self.score(guide).amax(-1)), steer)


class FeatureRefinement(nn.Module):
    """Augmentation of the selected points' features by their neighbours', fusion of the two branches."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.transpose = config.release_transpose
        self.point = Conv1x1(128, 128) if config.point_branch else None
        self.normal = Conv1x1(128, 128) if config.normal_branch else None

    def augment(self, conv: Conv1x1, f: Tensor, weight: Tensor, selected: Tensor, graph: Tensor) -> Tensor:
        """Add the weighted mean of the neighbours' features: f (B, M, 128) to (B, K, 128) of the selected points."""
        near = weight[..., None] * f  # (B, M, 128)
        if self.transpose:  # the released code makes (B, 128, M) of it and reads that buffer as (B, M, 128)
            near = near.transpose(1, 2).contiguous().view(f.shape)
        out: Tensor = conv(gather_points(f, selected) + gather_mean(near, graph))  # (B, K, 128)
        return out

    def forward(
        self, f_p: Tensor | None, f_n: Tensor | None, weight: Tensor, selected: Tensor, graph: Tensor
    ) -> FusedFeatures:
        """Features (B, M, 128), weights (B, M), selection (B, K) and its graph (B, K, k) to fused features."""
        point, normal, patch, local = None, None, None, None
        if self.point is not None and f_p is not None:
            point = self.augment(self.point, f_p, weight, selected, graph)
            patch = f_p.float().amax(1)
        if self.normal is not None and f_n is not None:
            normal = self.augment(self.normal, f_n, weight, selected, graph)
            local = normal + f_n.float().amax(1)[:, None]
        return FusedFeatures(_concat(point, normal), patch, _concat(local, point))


def _concat(own: Tensor | None, other: Tensor | None) -> Tensor | None:
    """Features of a branch followed by the other's, where there is another."""
    if own is None or other is None:
        return own
    return torch.cat([own, other], -1)


class PCDNF(nn.Module):
    """Joint denoising and normal filtering of patches.

    Parameters
    ----------
    config : NetworkConfig, optional
    """

    def __init__(self, config: NetworkConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or NetworkConfig()
        self.point_extractor = MultiscaleFeatureExtractor(config) if config.point_branch else None
        self.normal_extractor = MultiscaleFeatureExtractor(config) if config.normal_branch else None
        self.selector = ShapeAwareSelector(config) if config.selector else None
        self.refinement = FeatureRefinement(config) if config.refinement else None
        self.decoder = Decoder(config)

    def forward(self, points: Tensor, normals: Tensor) -> NetworkOutput:
        """Predict for the centres of B patches.

        Parameters
        ----------
        points : Tensor (B, M, 3), float32
            Patch points in the patch frame: centre at the origin, radius 1.
        normals : Tensor (B, M, 3), float32
            Their unit normals in the same frame.

        Returns
        -------
        NetworkOutput
            float32 whatever autocast says.
        """
        B, M, _ = points.shape
        f_p, f_n, refined_points, refined_normals = None, None, points, normals
        if self.point_extractor is not None:
            f_p, refined_points = self.point_extractor(points)  # (B, M, 128), (B, M, 3)
        if self.normal_extractor is not None:
            f_n, refined_normals = self.normal_extractor(normals)

        if self.selector is not None:
            refined = Patch(refined_points, refined_normals)
            weight, steer = self.selector(Patch(points, normals), refined, f_p, f_n)  # (B, M)
            selected = weight.topk(self.config.selected, dim=-1).indices  # (B, K)
        else:
            weight, steer = points.new_ones(B, M), None
            selected = torch.arange(M, device=points.device).expand(B, M)

        if self.refinement is not None:
            graph = knn(refined_points, self.config.k4, selected)  # (B, K, k4)
            fused = self.refinement(f_p, f_n, weight, selected, graph)
        else:
            f_p, f_n = (f if f is None else gather_points(f, selected) for f in (f_p, f_n))
            fused = FusedFeatures(f_p, None, f_n)
        displacement, normal = self.decoder(fused)

        if self.config.anchor:
            fit = anchor(points, weight, normals, steer)
            displacement = fit.displacement() + (0 if displacement is None else ANCHOR_REACH * displacement)
            normal = fit.normal() + (0 if normal is None else normal)
        if displacement is None:
            displacement = points.new_zeros(B, 3)
        if normal is None:
            centre = points.square().sum(-1).argmin(1, keepdim=True)
            normal = gather_points(normals, centre)[:, 0]
        return NetworkOutput(displacement, normal, weight, selected, refined_points, refined_normals)

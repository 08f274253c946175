"""Configuration of the paper's network."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NetworkConfig:
    """What a PCDNF is made of; the defaults are the paper's.

    Parameters
    ----------
    patch_points : int
        M, points of a patch.
    selected : int
        K, points the selector keeps.
    k1, k2, k3, k4 : int
        Neighbours: two graphs on the input, one in feature space, one of the augmentation.
    anchor : bool
        Predict corrections to a weighted quadric fit.
    selector, refinement, point_branch, normal_branch : bool
        The paper's table 5 switches off selector and refinement (V1), refinement (V2), the normal branch
        (V3), the point branch (V4).
    release_transpose : bool
        Reproduce the released code's reading of transposed features.
    """

    patch_points: int = 512
    selected: int = 256
    k1: int = 8
    k2: int = 16
    k3: int = 16
    k4: int = 10
    anchor: bool = False
    selector: bool = True
    refinement: bool = True
    point_branch: bool = True
    normal_branch: bool = True
    release_transpose: bool = False

    def __post_init__(self) -> None:
        if not (self.point_branch or self.normal_branch):
            raise ValueError("Keep at least one of point_branch and normal_branch.")
        if not self.k1 <= self.k2:
            raise ValueError(f"k1 = {self.k1} must not exceed k2 = {self.k2}: it is part of that graph.")

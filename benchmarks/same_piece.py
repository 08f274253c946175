"""Whether a piece of scan comes out the same whatever else is in its file: mean distance to the true surface.

    python benchmarks/same_piece.py

The piece has 4000 points; beside it lie copies, far points, a second object, or a piece thinner or denser. The errors
of the piece's own points shall agree within 3 %.
"""

from __future__ import annotations

import numpy as np

from pcdnf import Denoiser

COUNT, NOISE = 4000, 0.02


def height(points: np.ndarray) -> np.ndarray:
    return 0.3 * np.sin(2 * points[:, 0]) * np.cos(1.5 * points[:, 1])


def piece(count: int, seed: int = 0, *, shift: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    points = np.column_stack([*rng.uniform(-2, 2, (2, count)), np.zeros(count)])
    points[:, 2] = height(points) + rng.normal(0, NOISE, count)
    return points + np.array([shift, 0, 0])


def main() -> None:
    denoiser, own = Denoiser.load(device="cpu"), piece(COUNT)
    far = np.random.default_rng(0).uniform(-30, 30, (COUNT // 100, 3))
    cases = {
        "alone": own,
        "each point four times": np.tile(own, (4, 1)),
        "1 % of far points": np.concatenate([own, far]),
        "a second object": np.concatenate([own, piece(COUNT, 3, shift=60)]),
        "a thirtieth of the density beside it": np.concatenate([own, piece(COUNT // 30, 5, shift=4.2)]),
        "five times the density beside it": np.concatenate([own, piece(5 * COUNT, 6, shift=4.2)]),
    }
    alone = None
    for name, points in cases.items():
        after = denoiser.denoise(points).points[:COUNT]
        error = float(np.abs(after[:, 2] - height(after)).mean())
        alone = alone or error
        print(f"{name}: {error:.3e} ({100 * (error / alone - 1):+.1f} %)", flush=True)


if __name__ == "__main__":
    main()

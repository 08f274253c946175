"""How good the shipped models are: clean clouds x noise levels x iterations, as a Markdown table.

    python benchmarks/quality.py FOLDER [--clouds fandisk,bunny] [--levels 0.5,1] [--model pcdnf-lite] [--iterations 2]

FOLDER holds clean clouds as ``NAME.npy`` (N, 3) or ``NAME.npz`` (points, normals). Noise is Gaussian of LEVEL per cent
of the diagonal a coordinate, from ``numpy.random.default_rng(0)``; a file ``NAME_noise0.5.npy`` is taken where there
is one. Chamfer distance (CD) x 1e5, point-to-surface distance (P2S) x 1e3, normals in degrees (mean / RMS).
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcdnf import Denoiser
from pcdnf.denoiser import Frame, iteration_seed
from pcdnf.metrics import score
from pcdnf.normals import pca_normals

PCA_NEIGHBOURS = 100
"""Of the PCA normals in the row of the noisy input."""

Points = NDArray[np.float64]


def clean_cloud(folder: Path, name: str) -> tuple[Points, Points | None]:
    """Points, and normals where the file has them."""
    plain = folder / f"{name}.npy"
    if plain.exists():
        return np.load(plain).astype(np.float64), None
    with np.load(folder / f"{name}.npz") as arrays:
        return arrays["points"].astype(np.float64), arrays["normals"].astype(np.float64)


def noisy_cloud(folder: Path, name: str, clean: Points, level: float) -> Points:
    """The cloud at a noise level in per cent of its diagonal."""
    given = folder / f"{name}_noise{level:g}.npy"
    if given.exists():
        return np.load(given).astype(np.float64)
    noise = np.random.default_rng(0).normal(size=clean.shape)
    return clean + noise * level / 100 * np.linalg.norm(np.ptp(clean, axis=0))


def main() -> None:
    """Print the table, a line as soon as it is known."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--clouds", default="fandisk,boxunion,bunny,rocker-arm,nefertiti")
    parser.add_argument("--levels", default="0.5,1")
    parser.add_argument("--model", default="pcdnf-lite")
    parser.add_argument("--iterations", type=int, default=2)
    arguments = parser.parse_args()
    denoiser = Denoiser.load(arguments.model)
    print(f"{arguments.model}, {denoiser.device}, {denoiser.precision}\n")
    print("| cloud | noise | method | CD | P2S | normals | seconds |\n|---|---|---|---|---|---|---|", flush=True)
    for name in arguments.clouds.split(","):
        clean, clean_normals = clean_cloud(arguments.folder, name)
        for level in map(float, arguments.levels.split(",")):
            points = noisy_cloud(arguments.folder, name, clean, level)
            normals: NDArray[np.floating] | None = pca_normals(points, PCA_NEIGHBOURS)
            frame = Frame.of(points)
            seconds, label = 0.0, f"noisy, PCA k = {PCA_NEIGHBOURS}"
            for iteration in range(arguments.iterations + 1):
                scores = score(points, normals, clean, clean_normals)
                print(
                    f"| {name} | {level:g} % | {label} | {scores.chamfer_distance:.2f} | {scores.point_to_surface:.2f}"
                    f" | {scores.normal_mean:.1f} / {scores.normal_rms:.1f} | {seconds:.0f} |",
                    flush=True,
                )
                if iteration < arguments.iterations:
                    began = time.perf_counter()
                    seed = iteration_seed(0, iteration)
                    cloud = denoiser.prepare(points, normals if iteration else None, frame=frame, seed=seed)
                    result = denoiser.denoise_tile(cloud, 0, len(cloud))
                    points, normals = np.empty_like(points), np.empty(points.shape, np.float32)
                    points[cloud.order], normals[cloud.order] = result.points, result.normals
                    seconds, label = seconds + time.perf_counter() - began, f"{arguments.model} x {iteration + 1}"


if __name__ == "__main__":
    main()

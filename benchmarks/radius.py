"""Which patch radius a model is best used with, on held-out generated shapes.

    python benchmarks/radius.py MODEL [--radii 0.03,0.035,0.04,0.05] [--centres 1000]

Mean point-to-surface distance x 1e3 and normal error in degrees after one iteration, at random points of eight shapes
of 80 000 points, a row for each radius and noise level. Needs the ``train`` extra.
"""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np
from scipy.spatial import cKDTree

from pcdnf import Denoiser
from pcdnf.shapes import random_shape

FIRST_SEED = 2_000_000
"""Neither trained on nor validated on."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model")
    parser.add_argument("--radii", default="0.03,0.035,0.04,0.045,0.05")
    parser.add_argument("--levels", default="0.25,0.5,1,1.5")
    parser.add_argument("--shapes", type=int, default=8)
    parser.add_argument("--centres", type=int, default=1000)
    arguments = parser.parse_args()
    denoiser = Denoiser.load(arguments.model)
    shapes = [random_shape(np.random.default_rng(FIRST_SEED + i), 80_000) for i in range(arguments.shapes)]
    trees = [cKDTree(shape.points) for shape in shapes]
    print("| noise | radius | P2S | normals |\n|---|---|---|---|")
    for level in map(float, arguments.levels.split(",")):
        for radius in map(float, arguments.radii.split(",")):
            denoiser.recipe = dataclasses.replace(denoiser.recipe, radius=radius)
            errors = []
            for i, (shape, tree) in enumerate(zip(shapes, trees, strict=True)):
                rng = np.random.default_rng(i)
                cloud = denoiser.prepare(shape.points + rng.normal(size=shape.points.shape) * level / 100)
                cloud.order = rng.choice(len(cloud), arguments.centres, replace=False)
                tile = denoiser.denoise_tile(cloud, 0, arguments.centres)
                distance, nearest = tree.query(tile.points)
                height = np.abs(((tile.points - shape.points[nearest]) * shape.normals[nearest]).sum(1))
                cosine = np.abs((tile.normals * shape.normals[nearest]).sum(1)).clip(0, 1)
                errors.append((np.minimum(distance, height).mean() * 1e3, np.degrees(np.arccos(cosine)).mean()))
            surface, angle = np.mean(errors, 0)
            print(f"| {level:g} % | {radius:g} | {surface:.3f} | {angle:.2f} |", flush=True)


if __name__ == "__main__":
    main()

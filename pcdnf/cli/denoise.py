"""The command ``pcdnf denoise``."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import PcdnfError
from ..file_formats import SUFFIXES, TEXT_FORMATS, titles
from ..inference.options import check_iterations, check_radius, check_sensor
from .common import check_writable

if TYPE_CHECKING:
    from ..denoiser import Denoiser, DenoiseResult
    from ..formats import PointCloud

    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]


def add_denoise(subparsers: Subparsers) -> None:
    """Add the command ``denoise``."""
    parser = subparsers.add_parser(
        "denoise",
        help=f"denoise a file: {titles()}",
        description="Denoise a point cloud. The result keeps colours, other properties, comments, types and order. "
        "It gains normals and a record of how it was made.",
    )
    parser.add_argument("input", type=Path, help=f"{titles()} (see docs/formats.md)")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        help="the file to write; its extension chooses the format (.ply, .npz, …), else the input's format is kept",
    )
    parser.add_argument(
        "--iterations",
        default="auto",
        metavar="N",
        help="number of passes over the cloud; auto chooses it by the noise (default: auto)",
    )
    parser.add_argument(
        "--radius",
        default="auto",
        metavar="R",
        help="patch radius: auto, a length in the cloud's unit, or a percentage of its diagonal: 4%% (default: auto)",
    )
    parser.add_argument(
        "--fast",
        action="store_true",
        help="use half as many neighbours per point: about 1.4 times as fast, slightly less accurate",
    )
    parser.add_argument(
        "--model", metavar="M", help="name listed by `pcdnf models`, or a .safetensors file (default: pcdnf-lite)"
    )
    parser.add_argument("--device", default="auto", metavar="D", help="auto, cpu or cuda:N (default: auto)")
    parser.add_argument(
        "--precision",
        default="auto",
        choices=["auto", "float32", "bfloat16"],
        help="arithmetic of the network (default: auto)",
    )
    parser.add_argument(
        "--normals",
        default="auto",
        choices=["auto", "pca", "input"],
        help="initial normals: estimated at a scale that suits the noise (auto) or from 24 neighbours (pca), or "
        "read from the file (input) (default: auto)",
    )
    parser.add_argument("--orient", action="store_true", help="flip the normals to one side of the surface")
    parser.add_argument(
        "--outliers",
        default="keep",
        choices=["keep", "drop", "mark"],
        help="points that belong to no surface: keep them, leave them out, or add a column `outlier` (default: keep)",
    )
    parser.add_argument(
        "--sensor",
        default="",
        metavar="X,Y,Z",
        help="where the scanner stood, in the cloud's coordinates (--sensor=-1,0,2 if x is negative): shows which "
        "points lie between two surfaces along a ray, and the side of new normals (default: what a PTX, a gridded E57 "
        "or an organised PCD says)",
    )
    parser.add_argument(
        "--nonfinite",
        default="keep",
        choices=["keep", "reject", "drop"],
        help="rows that contain NaN or infinity: return them in place, refuse the file, or drop them (default: keep)",
    )
    parser.add_argument(
        "--ignore-classes",
        type=_classes,
        default=(),
        metavar="C,C",
        help="LAS classes that are returned unchanged and excluded from the fit, such as noise: 7,18",
    )
    parser.add_argument(
        "--coordinates",
        default="keep",
        choices=["keep", "float32", "float64"],
        help="type of the result's coordinates; float32 coordinates far from the origin are shifted by a recorded "
        "offset (default: keep)",
    )
    parser.add_argument(
        "--diagnostics",
        action="store_true",
        help="add columns to the result: displacement, estimated_noise, and confidence from 0 to 1 in each move",
    )
    parser.add_argument("--seed", type=_natural, default=0, metavar="S", help="seed of all random choices (default: 0)")
    parser.add_argument(
        "--picture", type=Path, metavar="PNG", help="also draw before, after and how far each point moved, as a PNG"
    )
    parser.add_argument("--quiet", action="store_true", help="print errors and warnings only")
    parser.set_defaults(run=_denoise)


def _natural(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError("must not be negative")
    return value


def _classes(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError("must be whole numbers with commas between them, such as 7,18") from None


def _denoise(options: argparse.Namespace) -> int:
    from ..formats import Limits, read
    from ..formats.aside import points_to_fit
    from ..formats.attributes import with_columns
    from ..formats.coordinates import without_steps
    from ..formats.files import format_to_write
    from ..formats.geographic import check_metric
    from ..formats.scanner_positions import known_sides, scanner_places

    for path in filter(None, (options.output, options.picture)):
        check_writable(path)
    format_to_write(options.output, "ply")
    check_iterations(options.iterations)
    check_radius(options.radius)
    options.sensor = check_sensor(options.sensor)
    cloud = read(options.input, limits=Limits(nonfinite=options.nonfinite))
    check_metric(cloud)
    cloud = points_to_fit(cloud, options.ignore_classes)
    if options.outliers != "keep":
        from ..geometry.outliers import treat_outliers

        cloud = treat_outliers(cloud, options.outliers, scanner_places(cloud, options.sensor))
    if options.normals == "input" and cloud.normals is None:
        raise PcdnfError("The file has no normals.", code="no_normals", hint="Remove --normals input to estimate them.")
    from ..denoiser import Denoiser
    from ..models.catalog import DEFAULT_MODEL

    denoiser = Denoiser.load(options.model or DEFAULT_MODEL, device=options.device, precision=options.precision)
    began = time.monotonic()
    result = _run(denoiser, cloud, options)
    seconds = time.monotonic() - began
    normals, cloud = result.normals, without_steps(cloud, float(result.metadata["estimated_noise"]))
    if options.orient:
        from ..geometry.orientation import orient_normals

        normals = orient_normals(result.points, normals, like=known_sides(cloud, options.sensor))
    around = {"orient": "on" if options.orient else "off", "outliers": options.outliers}
    denoised = cloud.replaced(result.points, normals, metadata=result.metadata | around)
    if options.diagnostics and result.diagnostics is not None:
        denoised = with_columns(denoised, result.diagnostics.columns())
    notes = denoised.warnings + _written(options.output, denoised, options)
    if result.flagged.any():
        notes.append(f"{int(result.flagged.sum())} points have too few neighbours and were left unchanged.")
    for note in notes:
        print(f"pcdnf: {note}", file=sys.stderr)
    if options.picture:
        from ..render.figure import draw

        draw(options.picture, [cloud, denoised], title=options.input.name)
    if not options.quiet:
        facts = result.metadata
        rate = len(cloud) * int(facts["iterations"]) / seconds
        how = f"{denoiser.device}, {denoiser.precision}, {facts['model']}"
        print(f"{len(cloud):,} points in {seconds:.1f} s ({rate:,.0f} points/s; {how}): {options.output}")
        print(f"noise about {facts['estimated_noise']}; iterations: {facts['iterations']}, radius: {facts['radius']}")
        print(f"points moved: {facts['moved']}, left: {facts['left']}, moved doubtfully far: {facts['doubtful']}")
    return 0


def _run(denoiser: Denoiser, cloud: PointCloud, options: argparse.Namespace) -> DenoiseResult:
    """Denoise and show a progress bar if standard error is a terminal."""
    from tqdm import tqdm

    from ..formats.scanner_positions import known_sides

    hidden = True if options.quiet else None
    with tqdm(unit=" points", unit_scale=True, disable=hidden, leave=False) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        return denoiser.denoise(
            cloud.points,
            known_sides(cloud, options.sensor),
            iterations=options.iterations,
            radius=options.radius,
            fast=options.fast,
            initial=options.normals,
            seed=options.seed,
            progress=progress,
        )


def _written(path: Path, cloud: PointCloud, options: argparse.Namespace) -> list[str]:
    """Write a result in the format of its extension, else of the input; return notes on what was lost."""
    from ..formats import write

    ending = path.suffix.lower()
    as_it_came = (
        cloud.flavour.format in TEXT_FORMATS and ending == options.input.suffix.lower()
    )  # a .txt may hold commas
    try:
        return write(
            path,
            cloud,
            format=cloud.flavour.format if as_it_came else SUFFIXES.get(ending),
            coordinates=options.coordinates,
            check=True,
        )
    except OSError as error:
        raise PcdnfError(
            f"{path} cannot be written: {error.strerror or type(error).__name__}.",
            code="unwritable_file",
            hint="Check the folder's permissions and the free disk space.",
        ) from error

"""The commands of ``pcdnf`` that need no service: denoise, evaluate, models, train, import-weights."""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .choices import check_iterations, check_radius
from .errors import PcdnfError
from .file_formats import SUFFIXES, TEXT_FORMATS, titles
from .formats import Limits, PointCloud, read, write
from .formats.cloud import checked

if TYPE_CHECKING:
    from .denoiser import Denoiser, DenoiseResult

    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

_NPY_MAGIC = b"\x93NUMPY"


def add_denoise(subparsers: Subparsers) -> None:
    """Add the command ``denoise``."""
    parser = subparsers.add_parser(
        "denoise",
        help=f"denoise a file: {titles()}",
        description="Denoise a point cloud. Colours, other properties, comments, types and order are kept; "
        "normals are added. The result says how it was made.",
    )
    parser.add_argument("input", type=Path, help=f"{titles()} (see docs/formats.md)")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        help="written as its ending says (.ply, .npz, …), else as the input was",
    )
    parser.add_argument(
        "--iterations", default="auto", metavar="N", help="passes over the cloud, or auto: by its noise (auto)"
    )
    parser.add_argument(
        "--radius",
        default="auto",
        metavar="R",
        help="size of the neighbourhoods: auto, a length in the cloud's unit, or a share of its diagonal: 4%% (auto)",
    )
    parser.add_argument(
        "--fast", action="store_true", help="half as many neighbours a point: about 1.4 times as fast, a little rougher"
    )
    parser.add_argument("--model", metavar="M", help="a name that `pcdnf models` lists, or a .safetensors file")
    parser.add_argument("--device", default="auto", metavar="D", help="auto, cpu or cuda:N (auto)")
    parser.add_argument("--precision", default="auto", choices=["auto", "float32", "bfloat16"])
    parser.add_argument(
        "--normals",
        default="auto",
        choices=["auto", "pca", "input"],
        help="raw normals: estimated at a scale that suits the noise, from 24 neighbours, or the file's (auto)",
    )
    parser.add_argument("--orient", action="store_true", help="turn the normals to one side of the surface")
    parser.add_argument("--outliers", default="keep", choices=["keep", "drop"], help="points far from all others")
    parser.add_argument("--nonfinite", default="reject", choices=["reject", "drop"], help="rows of NaN or infinity")
    parser.add_argument("--seed", type=_natural, default=0, metavar="S", help="of every random choice (0)")
    parser.add_argument(
        "--picture", type=Path, metavar="PNG", help="also draw before, after and how far each point moved"
    )
    parser.add_argument("--quiet", action="store_true", help="print errors and warnings only")
    parser.set_defaults(run=_denoise)


def _natural(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError("must not be negative")
    return value


def _denoise(options: argparse.Namespace) -> int:
    for path in filter(None, (options.output, options.picture)):
        check_writable(path)
    check_iterations(options.iterations)
    check_radius(options.radius)
    cloud = read(options.input, limits=Limits(nonfinite=options.nonfinite))
    if options.outliers == "drop":
        from .outliers import drop_outliers

        cloud = drop_outliers(cloud)
    if options.normals == "input" and cloud.normals is None:
        raise PcdnfError(
            "The file has no normals.", code="no_normals", hint="Leave out --normals input to have them estimated."
        )
    from .checkpoint import DEFAULT_MODEL
    from .denoiser import Denoiser

    denoiser = Denoiser.load(options.model or DEFAULT_MODEL, device=options.device, precision=options.precision)
    began = time.monotonic()
    result = _run(denoiser, cloud, options)
    seconds = time.monotonic() - began
    normals = result.normals
    if options.orient:
        from .orientation import orient_normals

        normals = orient_normals(result.points, normals, like=cloud.normals)
    around = {"orient": "on" if options.orient else "off", "outliers": options.outliers}
    denoised = cloud.replaced(result.points, normals, metadata=result.metadata | around)
    notes = cloud.warnings + _written(options.output, denoised, options.input)
    if result.flagged.any():
        notes.append(f"{int(result.flagged.sum())} points have too few neighbours and came back as they were.")
    for note in notes:
        print(f"pcdnf: {note}", file=sys.stderr)
    if options.picture:
        from .picture import draw

        draw(options.picture, [cloud, denoised], title=options.input.name)
    if not options.quiet:
        facts = result.metadata
        rate = len(cloud) * int(facts["iterations"]) / seconds
        how = f"{denoiser.device}, {denoiser.precision}, {facts['model']}"
        print(f"{len(cloud):,} points in {seconds:.1f} s ({rate:,.0f} points/s; {how}): {options.output}")
        print(f"noise about {facts['estimated_noise']}; iterations: {facts['iterations']}, radius: {facts['radius']}")
    return 0


def check_writable(path: Path) -> None:
    """Fail before the work, not after it."""
    if path.is_dir() or not path.parent.is_dir():
        raise PcdnfError(
            f"{path} cannot be written: {'it is a folder' if path.is_dir() else 'its folder does not exist'}.",
            code="unwritable_file",
            hint="Name a file in an existing folder.",
        )


def _run(denoiser: Denoiser, cloud: PointCloud, options: argparse.Namespace) -> DenoiseResult:
    """Denoise behind a progress bar, which a pipe does not get."""
    from tqdm import tqdm

    hidden = True if options.quiet else None
    with tqdm(unit=" points", unit_scale=True, disable=hidden, leave=False) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        return denoiser.denoise(
            cloud.points,
            cloud.normals,
            iterations=options.iterations,
            radius=options.radius,
            fast=options.fast,
            initial=options.normals,
            seed=options.seed,
            progress=progress,
        )


def _written(path: Path, cloud: PointCloud, source: Path) -> list[str]:
    """Write a result in the format its name asks for, else in that of the input; what could not be kept."""
    ending = path.suffix.lower()
    as_it_came = cloud.flavour.format in TEXT_FORMATS and ending == source.suffix.lower()  # a .txt may hold commas
    try:
        return write(path, cloud, format=None if as_it_came else SUFFIXES.get(ending))
    except OSError as error:
        raise PcdnfError(
            f"{path} cannot be written: {error.strerror or type(error).__name__}.",
            code="unwritable_file",
            hint="Check its folder's permissions and the space left.",
        ) from error


def add_evaluate(subparsers: Subparsers) -> None:
    """Add the command ``evaluate``."""
    parser = subparsers.add_parser(
        "evaluate",
        help="score a cloud against a clean one",
        description="Chamfer distance, point-to-surface distance and normal error, in units of the clean cloud's "
        "bounding-box diagonal. Clean normals are estimated where the file has none.",
    )
    parser.add_argument("prediction", type=Path, help=f"{titles()}, or NPY (N, 3)")
    parser.add_argument("clean", type=Path, help="the same")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=_evaluate)


def _evaluate(options: argparse.Namespace) -> int:
    prediction, clean = read_any(options.prediction), read_any(options.clean)
    from .metrics import score

    scores = score(prediction.points, prediction.normals, clean.points, clean.normals)
    if options.json:
        print(json.dumps(asdict(scores)))
        return 0
    print(f"points             {scores.points:,}")
    print(f"Chamfer distance   {scores.chamfer_distance:.3f} x 1e-5")
    print(f"point to surface   {scores.point_to_surface:.3f} x 1e-3")
    if scores.normal_mean is not None:
        print(f"normals            {scores.normal_mean:.2f} degrees mean, {scores.normal_rms:.2f} RMS")
    return 0


def read_any(path: Path) -> PointCloud:
    """A cloud from a file of any format, or from a plain (N, 3) array of floats.

    Raises
    ------
    PcdnfError
        ``bad_shape`` of an array, and what the readers raise.
    """
    try:
        with path.open("rb") as file:
            is_array = file.read(len(_NPY_MAGIC)) == _NPY_MAGIC
        points = np.load(path, allow_pickle=False) if is_array else None
    except OSError:
        return read(path)
    except ValueError:
        points = np.empty(0)
    if points is None:
        return read(path)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind != "f":
        raise PcdnfError(
            f"{path} does not hold an (N, 3) array of floats.", code="bad_shape", hint="Save x, y, z, one row a point."
        )
    return checked(PointCloud(points=points.astype(np.float64)), Limits())


def add_models(subparsers: Subparsers) -> None:
    """Add the command ``models``."""
    parser = subparsers.add_parser("models", help="list the models that come with the package")
    parser.add_argument("--json", action="store_true", help="print a JSON array with all facts")
    parser.set_defaults(run=_models)


def _models(options: argparse.Namespace) -> int:
    from .checkpoint import DEFAULT_MODEL, available_models

    models = available_models()
    if options.json:
        facts: list[dict[str, Any]] = [asdict(model) | {"path": str(model.path)} for model in models]
        print(json.dumps(facts))
        return 0
    for model in models:
        mark = " (default)" if model.name == DEFAULT_MODEL else ""
        print(
            f"{model.name}{mark}: {model.kind}, version {model.version}, {model.licence}, sha256 {model.sha256[:16]}…"
        )
        trained = model.training
        if "patches" in trained and "hours" in trained:
            print(f"    trained on {trained['patches']:,} patches in {trained['hours']:.1f} h")
    return 0


def add_train(subparsers: Subparsers, *, complete: bool) -> None:
    """Add the command ``train``; its options cost an import of torch, so only where they are needed."""
    parser = subparsers.add_parser("train", help="train a network on generated shapes")
    if complete:
        from .training_options import add_train_arguments

        add_train_arguments(parser)
    parser.set_defaults(run=_train)


def _train(options: argparse.Namespace) -> int:
    from .training import run

    run(options)
    return 0


def add_import_weights(subparsers: Subparsers) -> None:
    """Add the command ``import-weights``."""
    parser = subparsers.add_parser(
        "import-weights",
        help="convert the authors' released checkpoint",
        description="Convert a checkpoint of the authors' code (GitHub LabZhengLiu/PCDNF) for --model. "
        "Only tensors are read from it; no code in it is run.",
    )
    parser.add_argument("release", type=Path, help="the .pth file")
    parser.add_argument("-o", "--output", type=Path, required=True, help="the .safetensors file to write")
    parser.set_defaults(run=_import_weights)


def _import_weights(options: argparse.Namespace) -> int:
    check_writable(options.output)
    from .checkpoint import save_checkpoint
    from .patches import Recipe
    from .release import CONFIG, convert_release, read_release

    save_checkpoint(
        options.output,
        convert_release(read_release(options.release)),
        name=options.output.stem,
        kind="pcdnf",
        config=asdict(CONFIG),
        recipe=Recipe(kind="knn", points=CONFIG.patch_points, upward=False).as_dict(),
        training={"source": "the authors' release, https://github.com/LabZhengLiu/PCDNF"},
        licence="the authors'",
    )
    print(f"{options.output}: use it with pcdnf denoise --model {options.output}")
    return 0

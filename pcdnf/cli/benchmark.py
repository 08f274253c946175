"""The command ``pcdnf benchmark``."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar

from ..errors import PcdnfError

if TYPE_CHECKING:
    from ..benchmark.clouds import CleanCloud
    from ..benchmark.runs import Row

    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

LEVELS = (0.0, 0.25, 0.5, 1.0, 1.5, 2.5)
"""The paper's, and none: a method should leave a clean cloud alone."""
MADE_POINTS = 20_000
"""Of clouds made by code, unless told otherwise: minutes on a CPU."""
_Item = TypeVar("_Item")


def add_benchmark(subparsers: Subparsers) -> None:
    """Add the command ``benchmark``."""
    parser = subparsers.add_parser(
        "benchmark",
        help="score models and peers on clean clouds with noise",
        description="Clean clouds x noise x methods. Results are kept in a folder; what is there is not computed "
        "again. Writes table.csv, table.md, intervals.md and, with --pictures, PNGs.",
    )
    parser.add_argument(
        "clouds",
        type=Path,
        nargs="*",
        help="clean clouds (.npy, .npz, .ply) or folders of them; without any, four shapes by formula",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the results")
    parser.add_argument("--generated", type=_count, default=0, metavar="N", help="also N shapes of the training's kind")
    parser.add_argument("--points", type=_count, metavar="N", help="of each cloud: thins files (20 000 for made ones)")
    parser.add_argument("--levels", type=_listed(_level), default=list(LEVELS), help="per cent of the diagonal")
    parser.add_argument("--noise", type=_listed(str), default=["gaussian"], help="kinds of noise")
    parser.add_argument("--models", type=_listed(str), metavar="M,…", help="names or .safetensors files")
    parser.add_argument("--iterations", type=_listed(_iterations), default=[1, 2, 3, "auto"], help="1,2,3,auto")
    parser.add_argument("--peers", type=_listed(str), default=[], help="some of jet,bilateral,wlop,pca, or all")
    parser.add_argument("--pictures", action="store_true", help="draw errors and curves (extra `benchmark`)")
    parser.add_argument("--device", default="auto", metavar="D", help="auto, cpu or cuda:N (auto)")
    parser.add_argument("--precision", default="auto", choices=["auto", "float32", "bfloat16"])
    parser.add_argument("--fresh", action="store_true", help="compute again what is there")
    parser.set_defaults(run=_benchmark)


def _listed(item: Callable[[str], _Item]) -> Callable[[str], list[_Item]]:
    def items(text: str) -> list[_Item]:
        return [item(part.strip()) for part in text.split(",") if part.strip()]

    return items


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError("must be a whole number from 1 on")
    return int(text)


def _level(text: str) -> float:
    value = float(text)
    if not 0 <= value <= 100:
        raise argparse.ArgumentTypeError("levels are per cent of the diagonal, 0 to 100")
    return value


def _iterations(text: str) -> int | Literal["auto"]:
    if text == "auto":
        return "auto"
    return _count(text)


def _benchmark(options: argparse.Namespace) -> int:
    from ..benchmark.methods import Method, Noisy, our_methods
    from ..benchmark.noise import check_kind
    from ..benchmark.peers import PEERS, peer_methods
    from ..benchmark.report import Report
    from ..benchmark.runs import Results, cases
    from ..models.catalog import DEFAULT_MODEL

    if options.pictures and importlib.util.find_spec("matplotlib") is None:
        raise PcdnfError(
            "Pictures need matplotlib, which is not installed.",
            code="missing_extra",
            hint="pip install 'pcdnf[benchmark]', or leave out --pictures.",
        )
    for kind in options.noise:
        check_kind(kind)
    clouds = _clouds(options)
    peers = list(PEERS) if options.peers == ["all"] else options.peers
    methods: list[Method] = [Noisy(), *peer_methods(peers)]
    models = options.models or [DEFAULT_MODEL]
    methods += our_methods(models, options.iterations, device=options.device, precision=options.precision)
    results = Results(options.output, fresh=options.fresh)
    rows: list[Row] = []
    for case in cases(clouds, options.noise, options.levels):
        rows += results.run(case, methods, report=_print)
    for path in Report(results, clouds, rows).write(pictures=options.pictures):
        print(path)
    return 0


def _clouds(options: argparse.Namespace) -> list[CleanCloud]:
    from ..benchmark.clouds import analytic_clouds, generated_clouds, read_clouds

    count = options.points or MADE_POINTS
    clouds = read_clouds(options.clouds) if options.clouds else []
    if options.points:
        clouds = [cloud.thinned(options.points) for cloud in clouds]
    if options.generated:
        clouds += generated_clouds(options.generated, count)
    return clouds or analytic_clouds(count)


def _print(row: Row, new: bool) -> None:
    print(
        f"{row.cloud:<14} {row.noise} {row.level:<4g} % {row.method:<22} CD {row.chamfer_distance:8.3f}"
        f"  P2S {row.point_to_surface:7.3f}  normals {row.normal_mean:5.2f} / {row.normal_rms:5.2f}"
        f"  {row.seconds:6.1f} s{'' if new else '  (kept)'}",
        file=sys.stderr,
        flush=True,
    )

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
    from ..benchmark.choice import Choice
    from ..benchmark.clouds import CleanCloud
    from ..benchmark.methods import Method
    from ..benchmark.runs import Row
    from ..benchmark.scan_runs import ScanRow

    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

PEER_NAMES = "jet, bilateral, wlop, pca, pcl-mls, rimls, apss, cloudcompare (of scans also plane, and no wlop)"
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
        description="Score every method on every clean cloud with every noise. The results are kept in a folder and "
        "are not computed again. The command writes table.csv, table.md, intervals.md and, with --pictures, PNGs. "
        "With --scanners it scores methods on simulated scans against the true surface, and writes scans.csv, "
        "scans.md and PNGs.",
    )
    parser.add_argument(
        "clouds",
        type=Path,
        nargs="*",
        help="clean clouds (.npy, .npz, .ply) or folders of them; with --scanners, scans with their truth (.npz) "
        "(default: four shapes by formula, or simulated scans)",
    )
    parser.add_argument("--scanners", action="store_true", help="score methods on simulated scans (extra `scanners`)")
    parser.add_argument("--scans", type=_listed(str), default=[], metavar="KIND,…", help="kinds of scan (default: all)")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the results")
    parser.add_argument(
        "--generated", type=_count, default=0, metavar="N", help="add N generated shapes, or N scans of each kind"
    )
    parser.add_argument(
        "--points",
        type=_count,
        metavar="N",
        help="points of each cloud; files are thinned to N (default: 20000 for shapes, 80000 for scans)",
    )
    parser.add_argument(
        "--levels", type=_listed(_level), default=list(LEVELS), help="levels of noise, in per cent of the diagonal"
    )
    parser.add_argument("--noise", type=_listed(str), default=["gaussian"], help="kinds of noise")
    parser.add_argument("--models", type=_listed(str), metavar="M,…", help="names of models, or .safetensors files")
    parser.add_argument(
        "--iterations", type=_listed(_iterations), help="passes: some of 1,2,3,auto; scans allow only auto"
    )
    parser.add_argument(
        "--peers",
        type=_listed(str),
        default=[],
        help="some of jet,bilateral,wlop,pca,pcl-mls,rimls,apss,cloudcompare, or all; scans have plane but no wlop",
    )
    parser.add_argument("--pictures", action="store_true", help="draw errors and curves (extra `benchmark`)")
    parser.add_argument("--device", default="auto", metavar="D", help="auto, cpu or cuda:N (default: auto)")
    parser.add_argument(
        "--precision", default="auto", choices=["auto", "float32", "bfloat16"], help="arithmetic of the networks"
    )
    parser.add_argument("--fresh", action="store_true", help="compute all results again")
    parser.set_defaults(run=_benchmark)


def _listed(item: Callable[[str], _Item]) -> Callable[[str], list[_Item]]:
    def items(text: str) -> list[_Item]:
        return [item(part.strip()) for part in text.split(",") if part.strip()]

    return items


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError("must be a whole number of at least 1")
    return int(text)


def _level(text: str) -> float:
    value = float(text)
    if not 0 <= value <= 100:
        raise argparse.ArgumentTypeError("must be per cent of the diagonal, from 0 to 100")
    return value


def _iterations(text: str) -> int | Literal["auto"]:
    if text == "auto":
        return "auto"
    return _count(text)


def _benchmark(options: argparse.Namespace) -> int:
    if options.pictures and importlib.util.find_spec("matplotlib") is None:
        raise PcdnfError(
            "Pictures need matplotlib, which is not installed.",
            code="missing_extra",
            hint="Run pip install 'pcdnf[benchmark]', or leave out --pictures.",
        )
    return _on_scans(options) if options.scanners else _on_clouds(options)


def _on_clouds(options: argparse.Namespace) -> int:
    """Clean clouds x noise x methods."""
    from ..benchmark.methods import Noisy
    from ..benchmark.noise import check_kind
    from ..benchmark.peers import PEERS
    from ..benchmark.report import Report
    from ..benchmark.runs import Results, cases

    for kind in options.noise:
        check_kind(kind)
    clouds = _clouds(options)
    peers = list(PEERS) if options.peers == ["all"] else options.peers
    methods = [Noisy(), *_peers(peers), *_ours(options, [1, 2, 3, "auto"])]
    results = Results(options.output, fresh=options.fresh)
    rows: list[Row] = []
    for case in cases(clouds, options.noise, options.levels):
        rows += results.run(case, methods, report=_print)
    for path in Report(results, clouds, rows).write(pictures=options.pictures):
        print(path)
    return 0


def _on_scans(options: argparse.Namespace) -> int:
    """Return scans with their truth x methods."""
    from ..benchmark.methods import Noisy
    from ..benchmark.scan_peers import SCAN_PEERS
    from ..benchmark.scan_report import ScanReport
    from ..benchmark.scan_runs import ScanResults
    from ..benchmark.scans import TrueScan, read_scans, simulated_scans, thinned
    from ..scanners.catalog import POINTS

    scans = read_scans(options.clouds)
    if options.points:
        scans = [thinned(scan, options.points) for scan in scans]
    if options.scans or options.generated or not scans:
        scans += simulated_scans(options.scans, options.generated or 1, options.points or POINTS)
    peers = list(SCAN_PEERS) if options.peers == ["all"] else options.peers
    methods = [Noisy(), *_peers(peers, of_scans=True), *_ours(options, ["auto"])]
    results = ScanResults(options.output, fresh=options.fresh)
    truths = [TrueScan(scan) for scan in scans]
    rows: list[ScanRow] = []
    for truth in truths:
        rows += results.run(truth, methods, report=_print_scan)
    for path in ScanReport(results, truths, rows).write(pictures=options.pictures):
        print(path)
    return 0


def _peers(names: list[str], *, of_scans: bool = False) -> list[Method | Choice]:
    """Return the named peers; a sentence on standard error for each whose program is missing."""
    from ..benchmark.programs import missing_programs
    from ..benchmark.scan_peers import scan_peers, with_programs

    missing = missing_programs(names)
    for sentence in missing.values():
        print(sentence, file=sys.stderr)
    there = [name for name in names if name not in missing]
    return scan_peers(there) if of_scans else with_programs(there)


def _ours(options: argparse.Namespace, iterations: list[int | Literal["auto"]]) -> list[Method]:
    from ..benchmark.methods import our_methods
    from ..models.catalog import DEFAULT_MODEL

    return our_methods(
        options.models or [DEFAULT_MODEL],
        options.iterations or iterations,
        device=options.device,
        precision=options.precision,
    )


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


def _print_scan(row: ScanRow, new: bool) -> None:
    harm = "" if row.worse_by_sigma is None else f"  worse {100 * row.worse_by_sigma:5.2f} %"
    thin = "" if row.thin is None else f"  thin {row.thin:8.3f}"
    print(
        f"{row.scan:<26} {row.method:<28} {row.distance:8.3f}{harm}{thin}  normals {row.angle:5.2f}"
        f"  {row.seconds:6.1f} s{'' if new else '  (kept)'}",
        file=sys.stderr,
        flush=True,
    )

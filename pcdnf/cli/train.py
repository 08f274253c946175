"""The command ``pcdnf train``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..models.catalog import KINDS

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]


def add_train(subparsers: Subparsers) -> None:
    """Add the command ``train``."""
    parser = subparsers.add_parser(
        "train",
        help="train a network on generated shapes",
        description="Train a network on generated shapes. The folder holds the state of the run, and the same command "
        "resumes it.",
    )
    add_train_arguments(parser)
    parser.set_defaults(run=_train)


def _train(options: argparse.Namespace) -> int:
    from ..training.trainer import run

    run(options)
    return 0


def add_train_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``pcdnf train``."""
    parser.add_argument("folder", type=Path, help="folder of the run; an interrupted run resumes from it")
    parser.add_argument("--kind", choices=sorted(KINDS), default="lite", help="network to train (default: lite)")
    parser.add_argument(
        "--minutes", type=float, default=60.0, help="wall-clock time of the whole training (default: 60)"
    )
    parser.add_argument("--device", default="auto", help="auto, cpu or cuda:N (default: auto)")
    parser.add_argument("--threads", type=int, default=1, help="threads for torch (default: 1)")
    parser.add_argument("--workers", type=int, help="processes that prepare batches")
    parser.add_argument("--batch", type=int, help="patches per step")
    parser.add_argument("--learning-rate", type=float, metavar="RATE", help="peak of the learning rate")
    parser.add_argument("--start", metavar="MODEL", help="model to start from instead of random weights")
    parser.add_argument(
        "--first-pass", metavar="MODEL", help="model that denoises some training clouds once beforehand, or 'self'"
    )
    parser.add_argument(
        "--first-pass-share",
        type=float,
        default=0.4,
        metavar="SHARE",
        help="share of the clouds that --first-pass denoises (default: 0.4)",
    )
    parser.add_argument(
        "--save-every",
        type=float,
        default=150.0,
        metavar="SECONDS",
        help="time between two saved states (default: 150)",
    )
    parser.add_argument(
        "--validation-patches", type=int, default=2048, metavar="N", help="patches of the validation (default: 2048)"
    )
    parser.add_argument(
        "--validation-clouds", type=int, default=12, metavar="N", help="clouds of the validation (default: 12)"
    )
    parser.add_argument("--pool", type=int, default=64, help="training clouds held in memory at once (default: 64)")
    parser.add_argument(
        "--scans", type=float, default=0.0, metavar="SHARE", help="share of the clouds that are simulated scans"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of all random choices (default: 0)")

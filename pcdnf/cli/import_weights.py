"""The command ``pcdnf import-weights``."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from .common import check_writable

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]


def add_import_weights(subparsers: Subparsers) -> None:
    """Add the command ``import-weights``."""
    parser = subparsers.add_parser(
        "import-weights",
        help="convert the authors' released checkpoint",
        description="Convert a checkpoint of the authors' code (GitHub LabZhengLiu/PCDNF) for use with --model. "
        "Only its tensors are read; code in it is never executed.",
    )
    parser.add_argument("release", type=Path, help="the .pth file")
    parser.add_argument("-o", "--output", type=Path, required=True, help="the .safetensors file to write")
    parser.set_defaults(run=_import_weights)


def _import_weights(options: argparse.Namespace) -> int:
    check_writable(options.output)
    from ..geometry.recipe import Recipe
    from ..models.authors_weights import CONFIG, convert_release, read_release
    from ..models.checkpoint import save_checkpoint

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

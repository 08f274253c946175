"""A check that several commands share."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import PcdnfError

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]


def check_writable(path: Path) -> None:
    """Raise ``unwritable_file`` before the work starts if a file could not be written."""
    if path.is_dir() or not path.parent.is_dir():
        raise PcdnfError(
            f"{path} cannot be written: {'it is a folder' if path.is_dir() else 'its folder does not exist'}.",
            code="unwritable_file",
            hint="Name a file in an existing folder.",
        )

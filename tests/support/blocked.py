"""Python programs for which some libraries are not installed."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

_BLOCKER = """import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {blocked!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Blocker())
"""


def run_without(blocked: Iterable[str], program: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a program in a process that cannot import the top-level modules ``blocked``."""
    return subprocess.run(
        [sys.executable, "-c", _BLOCKER.format(blocked=sorted(blocked)) + program],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        timeout=120,
    )

"""Commands that read no cloud answer at once: what they import is counted, for a busy machine's seconds say little."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("torch", "numba", "scipy", "numpy", "pydantic", "fastapi", "sqlalchemy", "httpx", "tqdm")
COMMANDS = ("--help", "--version", "models", "models --json", "denoise --help", "train --help", "render --help",
            "submit --help", "serve --help", "drain --help", "doctor --help")  # fmt: skip
PROGRAM = f"""
import sys
from pcdnf.cli import main
try:
    status = main()
except SystemExit as ended:
    status = ended.code
print(*(name for name in {HEAVY!r} if name in sys.modules), file=sys.stderr)
sys.exit(status)
"""


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_that_reads_no_cloud_imports_no_heavy_library(command: str) -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM, *command.split()], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert done.stdout
    assert done.stderr.split() == []

"""What a process has imported."""

from __future__ import annotations

import subprocess
import sys


def imported(*modules: str) -> set[str]:
    """Return the names of all modules that a fresh interpreter has loaded after it imported these."""
    code = f"import sys, {', '.join(modules)}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    return set(done.stdout.split())

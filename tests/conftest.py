"""What all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # several processes share the cores: none may spin


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of benchmark clouds; a test that asks for it is skipped where there is none."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("PCDNF_SHARED_DATA", beside))
    if not folder.is_dir():
        pytest.skip("no benchmark data: set PCDNF_SHARED_DATA")
    return folder

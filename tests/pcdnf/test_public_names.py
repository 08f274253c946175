"""What other people's programs import: these names do not move."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

PUBLIC = {
    "pcdnf": {"DenoiseResult", "Denoiser", "PointCloud", "Stopped", "__version__"},
    "pcdnf.client": {
        "DEFAULT_URL", "Client", "Execution", "Job", "JobError", "Model", "Plan", "ProblemDetail", "ProblemError",
        "Progress", "Unreachable",
    },
    "pcdnf.formats": {
        "CODES", "E57Flavour", "FormatError", "LasFlavour", "Limits", "NpzFlavour", "PcdFlavour", "PlyFlavour",
        "PointCloud", "XyzFlavour", "read", "sniff", "write",
    },
    "pcdnf.errors": {"MissingExtra", "PcdnfError"},
}  # fmt: skip


@pytest.mark.parametrize("module", PUBLIC)
def test_every_public_name_can_be_imported(module: str) -> None:
    found = importlib.import_module(module)
    assert {name for name in PUBLIC[module] if not hasattr(found, name)} == set()
    assert set(getattr(found, "__all__", PUBLIC[module])) >= PUBLIC[module]


def test_the_package_itself_imports_nothing_heavy() -> None:
    program = "import sys, pcdnf; print(*({'torch', 'numba', 'scipy', 'numpy'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.split() == []

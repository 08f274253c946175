"""What the rooms of the service import, beyond what the contracts of import-linter say."""

from __future__ import annotations

import pkgutil
from types import ModuleType

import pytest

import service.database
import service.jobs
import service.storage
import service.worker
from tests.support.imports import imported


def _modules(package: ModuleType) -> list[str]:
    found = pkgutil.iter_modules(package.__path__, f"{package.__name__}.")
    return sorted(module.name for module in found if not module.name.endswith("__main__"))


@pytest.mark.parametrize("package", [service.database, service.storage, service.jobs, service.worker])
def test_only_the_api_imports_a_web_framework(package: ModuleType) -> None:
    modules = _modules(package)
    assert len(modules) >= 3
    assert not imported(*modules) & {"fastapi", "starlette", "uvicorn"}

"""Schemathesis is a pytest plugin. Only these tests load it, since its import takes seconds."""

from __future__ import annotations

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Load it."""
    config.pluginmanager.import_plugin("schemathesis.pytest.plugin")

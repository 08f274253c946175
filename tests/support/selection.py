"""Which tests run, in which order and in how many processes.

A pytest plugin. The quick tests run by default. Tests that need minutes are *full*: the folders of `FULL`, and tests
marked ``full``. They run with ``--all``, or if their path is given.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parents[1]
FULL = ("browser", "faults", "fuzz", "interop")
FIRST = ("docs", "test_readme.py", "test_examples.py", *FULL, "service", "pcdnf/client", "pcdnf/cli")
PROCESSES = 4  # at most


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--all``."""
    parser.addoption("--all", action="store_true", help=f"run the full tests too: {', '.join(FULL)}, and those marked")


def pytest_report_header(config: pytest.Config) -> str | None:
    """Name what is left out."""
    if not _is_quick(config):
        return None
    return f"quick tests; {', '.join(FULL)} and tests marked `full` run with --all"


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave the full folders out of the quick tests."""
    return True if collection_path.parent == TESTS and collection_path.name in FULL and _is_quick(config) else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the marked tests out of the quick ones, and put the longest files first."""
    if _is_quick(config):
        config.hook.pytest_deselected(items=[item for item in items if item.get_closest_marker("full")])
        items[:] = [item for item in items if not item.get_closest_marker("full")]
    items.sort(key=_rank)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Return some processes for the whole suite, and none for tests that were named."""
    return min(PROCESSES, max(2, os.cpu_count() or 1)) if _is_whole(config) else 0


def _is_whole(config: pytest.Config) -> bool:
    return all((config.invocation_params.dir / name).resolve() == TESTS for name in config.args)


def _is_quick(config: pytest.Config) -> bool:
    return _is_whole(config) and not config.getoption("--all")


def _rank(item: pytest.Item) -> int:
    path = item.path.relative_to(TESTS).as_posix()
    return next((rank for rank, start in enumerate(FIRST) if path.startswith(start)), len(FIRST))

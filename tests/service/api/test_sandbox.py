from __future__ import annotations

import asyncio
import logging
from pathlib import Path

import pytest

from service.api.sandbox import Sandbox
from service.problems import Problem
from service.settings import Settings


@pytest.fixture(autouse=True)
def modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules that end in some ways, for a child process to run."""
    endings = {
        "ends_well": """print('{"ok": true}')""",
        "is_killed": "import os; os.kill(os.getpid(), 9)",
        "aborts": "import os; os.abort()",
        "is_broken": "raise RuntimeError('somebody.ply')",
    }
    for name, code in endings.items():
        (tmp_path / f"{name}.py").write_text(code)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))


def test_an_answer() -> None:
    assert asyncio.run(Sandbox(Settings()).ask("ends_well", "argument")) == {"ok": True}


@pytest.mark.parametrize(("module", "status"), [("is_killed", -9), ("aborts", -6)])
def test_a_child_that_a_signal_ends_had_no_memory(module: str, status: int, caplog: pytest.LogCaptureFixture) -> None:
    answer = asyncio.run(Sandbox(Settings()).ask(module))
    assert (answer["ok"], answer["code"]) == (False, "not_enough_memory")
    assert answer["hint"]
    assert f"{module} ended with status {status}" in caplog.text


def test_a_child_with_a_defect_is_the_services_fault(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.ERROR)
    with pytest.raises(Problem) as caught:
        asyncio.run(Sandbox(Settings()).ask("is_broken"))
    assert (caught.value.code, caught.value.status) == ("internal_error", 500)
    assert "is_broken ended with status 1" in caplog.text
    assert "somebody.ply" not in caplog.text

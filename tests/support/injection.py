"""Faults put into processes that are started later: a module of theirs is changed as it is imported."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from tests.support.apart import Apart

INJECTOR = """
from __future__ import annotations

import importlib.util, os, sys

class Injector:
    def find_spec(self, name, path=None, target=None):
        if name != {module!r}:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        load = spec.loader.exec_module
        def exec_module(module):
            load(module)
            {change}(module)
        spec.loader.exec_module = exec_module
        return spec

sys.meta_path.insert(0, Injector())

"""


def inject(service: Apart, folder: Path, module: str, change: Callable[[ModuleType], None], **variables: Path) -> None:
    """Let every process that the service starts from now on call ``change`` with a module once it is imported.

    ``change`` is taken as source, so it imports what it needs; ``variables`` are in its environment.
    """
    text = INJECTOR.format(module=module, change=change.__name__) + inspect.getsource(change)
    (folder / "sitecustomize.py").write_text(text)
    found = os.pathsep.join([str(folder), service.environment.get("PYTHONPATH", "")])
    service.environment |= {"PYTHONPATH": found} | {name: str(value) for name, value in variables.items()}

"""The command ``pcdnf models``."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]


def add_models(subparsers: Subparsers) -> None:
    """Add the command ``models``."""
    parser = subparsers.add_parser("models", help="list the models that come with the package")
    parser.add_argument("--json", action="store_true", help="print a JSON array with all facts")
    parser.set_defaults(run=_models)


def _models(options: argparse.Namespace) -> int:
    from ..models.catalog import DEFAULT_MODEL, available_models

    models = available_models()
    if options.json:
        facts: list[dict[str, Any]] = [asdict(model) | {"path": str(model.path)} for model in models]
        print(json.dumps(facts))
        return 0
    for model in models:
        mark = " (default)" if model.name == DEFAULT_MODEL else ""
        print(
            f"{model.name}{mark}: {model.kind}, version {model.version}, {model.licence}, sha256 {model.sha256[:16]}…"
        )
        trained = model.training
        if "patches" in trained and "hours" in trained:
            print(f"    trained on {trained['patches']:,} patches in {trained['hours']:.1f} h")
    return 0

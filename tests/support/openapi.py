"""Reading an OpenAPI document."""

from __future__ import annotations

from typing import Any


def pointed(document: dict[str, Any], reference: dict[str, Any]) -> dict[str, Any]:
    """What a `$ref` leads to, or the object itself."""
    found: Any = document if "$ref" in reference else reference
    for name in reference.get("$ref", "#").split("/")[1:]:
        found = found[name]
    return dict(found)

"""The faults that pydantic finds in settings and parameters, in the words of the service."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_REASONS = {
    "bool_parsing": "must be true or false",
    "extra_forbidden": "there is no such parameter",
    "float_parsing": "must be a number",
    "greater_than": "must be more than {gt}",
    "greater_than_equal": "must be at least {ge}",
    "int_from_float": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_parsing_size": "must be a smaller number",
    "less_than": "must be less than {lt}",
    "less_than_equal": "must be at most {le}",
    "literal_error": "must be {expected}",
    "missing": "must be given",
    "string_too_short": "must have at least {min_length} characters",
    "value_error": "{error}",
}


def reason(fault: Mapping[str, Any]) -> str:
    """Return what is wrong with a value, in words that follow its name and a colon.

    Parameters
    ----------
    fault : mapping
        One of pydantic's ``errors()``, or a mapping with only ``msg``.
    """
    words = _REASONS.get(fault.get("type", ""))
    if words is None:
        return str(fault["msg"]).removesuffix(".")
    facts = {name: f"{fact:g}" if isinstance(fact, float) else fact for name, fact in fault.get("ctx", {}).items()}
    return words.format(**facts).removesuffix(".")

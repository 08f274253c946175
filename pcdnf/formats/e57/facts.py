"""The facts of an E57 scan (sensor, weather, times, limits), read from the XML and written as nodes."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

MAX_DEPTH = 16
_STANDARD = "{http://www.astm.org/COMMIT/E57/2010-e57-v1.0}"


@dataclass(frozen=True)
class Fact:
    """One node of the XML.

    Attributes
    ----------
    name : str
    kind : str
        ``Structure``, ``Vector``, ``String``, ``Integer``, ``ScaledInteger`` or ``Float``.
    text : str
        Its value.
    options : tuple of (str, str)
        Its attributes, such as bounds and precision.
    parts : tuple of Fact
        What a structure or vector holds.
    """

    name: str
    kind: str
    text: str = ""
    options: tuple[tuple[str, str], ...] = ()
    parts: tuple[Fact, ...] = ()

    def number(self, name: str) -> float | None:
        """Return the value of one of its parts as a number."""
        text = next((part.text or "0" for part in self.parts if part.name == name), "")
        try:
            return float(text)
        except ValueError:
            return None


def read_facts(node: ElementTree.Element, known: Collection[str]) -> tuple[tuple[Fact, ...], list[str]]:
    """Return the parts of a node except the `known` ones, and the names of those that cannot be kept."""
    facts, lost = [], []
    for child in node:
        name = child.tag.removeprefix(_STANDARD).rpartition("}")[2]
        if name in known:
            continue
        fact = _fact(child, MAX_DEPTH)
        if fact is None:
            lost.append(name)
        else:
            facts.append(fact)
    return tuple(facts), lost


def _fact(node: ElementTree.Element, depth: int) -> Fact | None:
    """Return a node with its contents; None for binary data, other extensions, and values that E57 does not have."""
    kind, name = node.get("type", ""), node.tag.removeprefix(_STANDARD)
    if depth == 0 or "}" in name:
        return None
    options = tuple((key, value) for key, value in node.attrib.items() if key != "type")
    if kind in ("Structure", "Vector"):
        parts = [_fact(child, depth - 1) for child in node]
        if any(part is None for part in parts):
            return None
        return Fact(name, kind, options=options, parts=tuple(part for part in parts if part is not None))
    fact = Fact(name, kind, node.text or "", options)
    return fact if kind == "String" or (kind in _NUMBERS and _is_sound(fact)) else None


_NUMBERS = ("Integer", "ScaledInteger", "Float")


def _is_sound(fact: Fact) -> bool:
    """Whether the value and the bounds of a number are numbers of its kind."""
    number = float if fact.kind == "Float" else _whole
    options = dict(fact.options)
    try:
        value, least, most = (number(text or "0") for text in (fact.text, *(_bounds(fact.kind, options))))
        factors = [float(options.get(key, "1")) for key in ("scale", "offset")]
    except ValueError:
        return False
    return least <= value <= most and all(abs(factor) < 1e300 for factor in factors)


def _bounds(kind: str, options: dict[str, str]) -> tuple[str, str]:
    widest = ("-inf", "inf") if kind == "Float" else (str(-(2**63)), str(2**63 - 1))
    return options.get("minimum", widest[0]), options.get("maximum", widest[1])


def _whole(text: str) -> int:
    value = int(text)
    if not -(2**63) <= value < 2**63:
        raise ValueError(text)
    return value


def fact_node(image: Any, libe57: Any, fact: Fact) -> Any:
    """Return a fact as a node of the library."""
    options = dict(fact.options)
    if fact.kind == "Structure":
        node = libe57.StructureNode(image)
        for part in fact.parts:
            node.set(part.name, fact_node(image, libe57, part))
        return node
    if fact.kind == "Vector":
        node = libe57.VectorNode(image, True)
        for part in fact.parts:
            node.append(fact_node(image, libe57, part))
        return node
    if fact.kind == "String":
        return libe57.StringNode(image, fact.text)
    if fact.kind == "Float":
        single = options.get("precision") == "single"
        return libe57.FloatNode(image, float(fact.text or "0"), libe57.E57_SINGLE if single else libe57.E57_DOUBLE)
    value, least, most = (_whole(text) for text in (fact.text or "0", *_bounds(fact.kind, options)))
    if fact.kind == "Integer":
        return libe57.IntegerNode(image, value, least, most)
    scale, offset = float(options.get("scale", "1")), float(options.get("offset", "0"))
    return libe57.ScaledIntegerNode(image, value, least, most, scale, offset)


def limits(name: str, **parts: float) -> Fact:
    """Return a structure of numbers, such as bounds."""
    kinds = {key: "Integer" if isinstance(value, int) else "Float" for key, value in parts.items()}
    return Fact(name, "Structure", parts=tuple(Fact(key, kinds[key], repr(value)) for key, value in parts.items()))

from __future__ import annotations

import pytest

from service.results import MEDIA_TYPES, _accepted


@pytest.mark.parametrize(
    ("accept", "expected"),
    [
        ("*/*", "own"),
        ("", None),
        ("application/ply", "ply"),
        ("application/x-npz", "npz"),
        ("application/*", "own"),
        ("application/octet-stream", "own"),
        ("text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8", "own"),
        ("application/ply;q=0.2, application/x-npz;q=0.9", "npz"),
        ("application/ply, */*;q=0.5", "ply"),
        ("application/ply;q=0, application/*", "npz"),
        ("application/ply;q=x", None),
        ("text/html", None),
    ],
)
@pytest.mark.parametrize("own", ["ply", "npz"])
def test_accept(accept: str, expected: str | None, own: str) -> None:
    assert _accepted(accept, own) == (own if expected == "own" else expected)


def test_both_formats_have_a_media_type() -> None:
    assert set(MEDIA_TYPES) == {"ply", "npz"}

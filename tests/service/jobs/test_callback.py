"""Which addresses a job may name for its message, and how the message is signed."""

from __future__ import annotations

import pytest

from service.jobs.callback import CallbackError, check_url, signature

HOSTS = ["hooks.example.org"]


@pytest.mark.parametrize("url", ["https://hooks.example.org", "https://HOOKS.example.org:443/a/b?job=1"])
def test_addresses_on_allowed_hosts(url: str) -> None:
    assert check_url(url, HOSTS).hostname == "hooks.example.org"


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("http://hooks.example.org/", "must be an address such as https"),
        ("https:///a", "must be an address"),
        ("file:///etc/passwd", "must be an address"),
        ("https://hooks.example.org:99999/", "must be an address"),
        ("https://[::1", "must be an address"),
        ("https://hooks.example.org/" + "a" * 2000, "must be an address"),
        ("https://user:word@hooks.example.org/", "must not have a user name"),
        ("https://hooks.example.org/#part", "fragment"),
        ("https://hooks.example.org:8443/", "port 8443"),
        ("https://hooks.example.org.evil.org/", "is not one that this service sends to"),
        ("https://evil.org/hooks.example.org", "is not one that this service sends to"),
        ("https://127.0.0.1/", "is not one that this service sends to"),
    ],
)
def test_other_addresses(url: str, words: str) -> None:
    with pytest.raises(CallbackError, match=words):
        check_url(url, HOSTS)
    with pytest.raises(CallbackError, match="sends no callbacks"):
        check_url("https://hooks.example.org", [])


def test_the_signature_covers_id_time_and_body() -> None:
    given = ("a secret of the tests, thirty-two", "msg", 1_700_000_000, b"{}")
    first = signature(*given)
    assert first.startswith("v1,")
    assert len(first) == 3 + 44
    for other in (("b", *given[1:]), (given[0], "m", *given[2:]), (*given[:2], 1, given[3]), (*given[:3], b"[]")):
        assert signature(*other) != first

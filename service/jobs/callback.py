"""Callbacks: which addresses a job may name, and how a message is signed.

Messages follow the Standard Webhooks specification: ``webhook-id``, ``webhook-timestamp`` and ``webhook-signature``.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
from collections.abc import Collection
from typing import Literal
from urllib.parse import SplitResult, urlsplit

LONGEST_URL = 2000
QUEUE, CONCURRENCY = "callbacks", 4
WORKFLOW = "callback"

ATTEMPTS = 8

State = Literal["due", "queued", "delivered", "given_up"]
"""Of the callback of a job: it waits for the end of the job, is being sent, was taken, or was never taken."""


class CallbackError(ValueError):
    """An address that no message may be sent to; the text follows the name of the parameter."""


def workflow_ids(job_id: str) -> list[str]:
    """Return the names of the attempts to deliver the callback of a job."""
    return [f"{job_id}-callback-{attempt}" for attempt in range(ATTEMPTS)]


def check_url(url: str, hosts: Collection[str]) -> SplitResult:
    """Return the parts of an address that messages may be sent to.

    Parameters
    ----------
    url : str
    hosts : collection of str
        The hosts that the operator allows.

    Raises
    ------
    CallbackError
    """
    if not hosts:
        raise CallbackError("this service sends no callbacks")
    try:
        parts = urlsplit(url)
        port = parts.port or 443
    except ValueError:
        raise CallbackError("must be an address such as https://example.org/done") from None
    if parts.scheme != "https" or not parts.hostname or len(url) > LONGEST_URL or not url.isascii():
        raise CallbackError("must be an address such as https://example.org/done")
    if parts.username is not None or parts.fragment:
        raise CallbackError("must not have a user name, a password or a fragment")
    if port != 443 or parts.hostname not in hosts:
        raise CallbackError(f"the host {parts.hostname[:60]!r}, port {port}, is not one that this service sends to")
    return parts


def signature(secret: str, message_id: str, timestamp: int, body: bytes) -> str:
    """Return the value of ``webhook-signature``.

    Parameters
    ----------
    secret : str
        Shared by the service and the receiver.
    message_id : str
        The value of ``webhook-id``.
    timestamp : int
        The value of ``webhook-timestamp``, in seconds since 1970.
    body : bytes
    """
    signed = f"{message_id}.{timestamp}.".encode() + body
    return "v1," + base64.b64encode(hmac.digest(secret.encode(), signed, hashlib.sha256)).decode()

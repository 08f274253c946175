"""The delivery of callbacks: durable, signed, to public addresses only.

A loop of the worker puts the callbacks of ended jobs onto a queue, however the jobs ended. Each attempt is a workflow
of its own, and a failed one queues the next with a delay, so a receiver that is away holds up nothing.
"""

from __future__ import annotations

import ipaddress
import json
import logging
import socket
import ssl
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Literal
from urllib.parse import SplitResult, urlunsplit

import httpx
import sqlalchemy as sa
from dbos import DBOS, SetEnqueueOptions, SetWorkflowID

from ..database.tables import jobs as table
from ..jobs.callback import ATTEMPTS, QUEUE, WORKFLOW, CallbackError, State, check_url, signature, workflow_ids
from ..jobs.job import FINISHED, Job
from ..settings import Settings
from .context import runtime

log = logging.getLogger(__name__)

FIRST_DELAY, BACKOFF = 5.0, 4.0  # seconds: 5, 20, 80, … 20480, together 7.6 hours
SEND_SECONDS = 10.0
MOST_AT_A_TIME = 100
_NAT64 = ipaddress.ip_network("64:ff9b::/96")

Outcome = Literal["delivered", "failed", "given_up"]
Address = ipaddress.IPv4Address | ipaddress.IPv6Address


def queue_due(engine: sa.Engine) -> int:
    """Queue the callbacks of jobs that have ended; return how many."""
    due = sa.select(table.c.id).where(table.c.callback == "due", table.c.status.in_(FINISHED)).limit(MOST_AT_A_TIME)
    with engine.connect() as connection:
        ids = list(connection.execute(due).scalars())
    for job_id in ids:
        _queue(job_id, 0)  # a second time changes nothing: the id of the workflow is the same
        _settle(engine, job_id, "queued")
    return len(ids)


@DBOS.workflow(name=WORKFLOW, max_recovery_attempts=100)
def callback(job_id: str, attempt: int) -> str:
    """Try once to deliver the callback of a job; return what came of it."""
    outcome: Outcome = attempt_delivery(job_id)
    if outcome == "failed" and attempt + 1 < ATTEMPTS:
        _queue(job_id, attempt + 1)
        return outcome
    _settle(runtime().engine, job_id, "delivered" if outcome == "delivered" else "given_up")
    return outcome


@DBOS.step(name="attempt_callback")
def attempt_delivery(job_id: str) -> Outcome:
    """Send the message of a job that has ended."""
    job = runtime().attempts.get(job_id)
    return "given_up" if job is None else deliver(job, runtime().settings)


def deliver(job: Job, settings: Settings) -> Outcome:
    """Send the message of `job`, unless the operator does not allow its host any more."""
    try:
        target = check_url(job.parameters["callback_url"], settings.callback_host_names)
        status = send(target, message(job), job.id, settings.callback_secret or "")
    except CallbackError as error:
        log.warning("the callback of job %s is given up: %s", job.id, error)
        return "given_up"
    except (httpx.HTTPError, OSError) as error:
        log.warning("the callback of job %s was not taken: %s", job.id, type(error).__name__)
        return "failed"
    if 200 <= status < 300:
        return "delivered"
    log.warning("the callback of job %s was answered %d", job.id, status)
    return "given_up" if status == 410 else "failed"  # 410: the receiver wants no more


def message(job: Job) -> bytes:
    """Return the body: what ended and how, but nothing of the cloud."""
    ended = datetime.fromtimestamp((job.finished_at or 0) / 1000, UTC)
    links = {"self": f"/jobs/{job.id}"} | ({"result": f"/jobs/{job.id}/result"} if job.status == "succeeded" else {})
    data = {"id": job.id, "status": job.status, "problem": job.problem, "links": links}
    return json.dumps({"type": f"job.{job.status}", "timestamp": ended.isoformat(), "data": data}).encode()


def send(
    target: SplitResult,
    body: bytes,
    message_id: str,
    secret: str,
    *,
    is_allowed: Callable[[Address], bool] | None = None,
    context: ssl.SSLContext | None = None,
) -> int:
    """Post a signed message and return the status of the answer, whose body is not read; redirects are not followed.

    The host is resolved once. The connection goes to the address that was checked, so a name that points elsewhere a
    moment later leads nowhere.

    Parameters
    ----------
    target : SplitResult
    body : bytes
    message_id, secret : str
    is_allowed : callable, optional
        Whether an address may be connected to; by default :func:`is_public`.
    context : ssl.SSLContext, optional

    Raises
    ------
    CallbackError
        If the host has an address that is not public.
    httpx.HTTPError, OSError
        If it does not answer.
    """
    assert target.hostname is not None
    port = target.port or 443
    address = _address(target.hostname, port, is_allowed or is_public)
    pinned = f"[{address}]" if address.version == 6 else str(address)
    url = urlunsplit((target.scheme, f"{pinned}:{port}", target.path or "/", target.query, ""))
    now = int(time.time())
    headers = {
        "Host": target.netloc,
        "Content-Type": "application/json",
        "User-Agent": "pcdnf-callback",
        "webhook-id": message_id,
        "webhook-timestamp": str(now),
        "webhook-signature": signature(secret, message_id, now, body),
    }
    verify = context or ssl.create_default_context()
    with (
        httpx.Client(trust_env=False, follow_redirects=False, timeout=SEND_SECONDS, verify=verify) as client,
        client.stream(
            "POST", url, content=body, headers=headers, extensions={"sni_hostname": target.hostname}
        ) as response,
    ):
        return response.status_code


def is_public(address: Address) -> bool:
    """Return whether an address is one of the public internet, also behind the forms in which IPv6 hides IPv4."""
    if isinstance(address, ipaddress.IPv6Address):
        hidden = address.ipv4_mapped or address.sixtofour or (address.teredo[1] if address.teredo else None)
        if hidden is not None or address in _NAT64:
            return False
    return address.is_global and not address.is_multicast


def _address(host: str, port: int, is_allowed: Callable[[Address], bool]) -> Address:
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    addresses = [ipaddress.ip_address(str(sockaddr[0]).partition("%")[0]) for *_, sockaddr in found]
    if not addresses or not all(map(is_allowed, addresses)):
        raise CallbackError(f"the host {host!r} has an address that is not public")
    return addresses[0]


def _queue(job_id: str, attempt: int) -> None:
    delay = FIRST_DELAY * BACKOFF ** (attempt - 1) if attempt else None
    with SetWorkflowID(workflow_ids(job_id)[attempt]), SetEnqueueOptions(delay_seconds=delay):
        DBOS.enqueue_workflow(QUEUE, callback, job_id, attempt)


def _settle(engine: sa.Engine, job_id: str, state: State) -> None:
    open_ = table.c.callback.in_(("due", "queued")) if state != "queued" else table.c.callback == "due"
    with engine.begin() as connection:
        connection.execute(table.update().where(table.c.id == job_id, open_).values(callback=state))

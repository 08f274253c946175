"""The pace of an upload: a deadline, and a minimum average speed."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator

from fastapi import Request

from ...problems import Problem
from ...settings import Settings

RATE_GRACE_SECONDS = 10.0


async def chunks(request: Request, settings: Settings) -> AsyncIterator[bytes]:
    """Yield the body's chunks while they come fast enough.

    Raises
    ------
    Problem
        408 once they do not.
    """
    start = time.monotonic()
    received = 0
    stream = request.stream()
    while True:
        elapsed = time.monotonic() - start
        allowed = settings.upload_deadline - elapsed
        if settings.upload_min_rate:
            allowed = min(allowed, RATE_GRACE_SECONDS + received / settings.upload_min_rate - elapsed)
        try:
            async with asyncio.timeout(max(allowed, 0)):
                chunk = await anext(stream)
        except StopAsyncIteration:
            return
        except TimeoutError as error:
            raise Problem(
                "upload_too_slow",
                f"The upload took longer than {settings.upload_deadline:g} seconds, or was slower than "
                f"{settings.upload_min_rate} bytes per second.",
                hint="Send the file again over a faster connection, or send a smaller one.",
                headers={"Connection": "close"},
            ) from error
        received += len(chunk)
        yield chunk

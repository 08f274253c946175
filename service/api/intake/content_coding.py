"""``Content-Encoding: gzip`` of a request: inflated piece by piece, so that a few bytes never become many at once."""

from __future__ import annotations

from collections.abc import AsyncIterator

from fastapi import Request

from pcdnf.gzip_stream import GzipError, Inflater

from ...problems import Problem

CODINGS = ("gzip", "x-gzip")


async def decoded(request: Request, chunks: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    """Yield the body without its content coding, in pieces of at most a MiB; whoever takes them counts them.

    Raises
    ------
    Problem
        415 for another coding than gzip, 422 for a body that is not what its coding says.
    """
    coding = _coding(request)
    if coding in ("", "identity"):
        async for chunk in chunks:
            yield chunk
        return
    if coding not in CODINGS:
        raise Problem(
            "unsupported_encoding",
            "The Content-Encoding of the upload is not supported.",
            hint="Send the file without one, or compressed by gzip.",
            headers={"Accept-Encoding": "gzip"},
        )
    inflater = Inflater()
    try:
        async for chunk in chunks:
            for piece in inflater.feed(chunk):
                yield piece
        inflater.finish()
    except GzipError as error:
        raise Problem(
            "invalid_upload",
            f"The body is not what its Content-Encoding says: {error}.",
            hint="Compress the whole body with gzip, or send it without Content-Encoding.",
        ) from error


def _coding(request: Request) -> str:
    return request.headers.get("content-encoding", "").strip().lower()

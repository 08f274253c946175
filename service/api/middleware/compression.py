"""Compression of responses, if the caller accepts gzip and it pays.

It pays for the page with its scripts, for the description of the API and for long JSON. Clouds are left as they are:
they shrink little, and their digest, length and ranges are those of the file.
"""

from __future__ import annotations

from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.types import ASGIApp

from pcdnf.file_formats import FORMATS

LEAST_BYTES = 1400  # what one packet carries anyway
LEVEL = 6
NOT_COMPRESSED = (
    *DEFAULT_EXCLUDED_CONTENT_TYPES,
    *dict.fromkeys(format_.media_type for format_ in FORMATS.values()),
    "application/octet-stream",
    "model/gltf-binary",
)


class Compression(GZipMiddleware):
    """Compresses the body of a response with gzip.

    Parameters
    ----------
    app : ASGI application
    """

    def __init__(self, app: ASGIApp) -> None:
        super().__init__(app, LEAST_BYTES, LEVEL, exclude_content_types=NOT_COMPRESSED)

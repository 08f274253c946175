"""The pages for people: the viewer at ``/`` and the API reference at ``/docs``, as static files.

Everything they load comes from this service, so they work without other network access and under the policy below.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fastapi import FastAPI, Response
from fastapi.responses import FileResponse
from starlette.staticfiles import StaticFiles

from ..middleware.guard import POLICY

FOLDER = Path(__file__).parents[2] / "viewer"
REVALIDATE = {"Cache-Control": "no-cache"}  # an update is seen at the next visit; unchanged files answer 304

DOCS_POLICY = f"{POLICY}; img-src 'self' data:"
"""That of ``/docs``: the style sheet of Swagger UI has its icons inside."""


class _Files(StaticFiles):
    def file_response(self, *arguments: Any, **options: Any) -> Response:
        response = super().file_response(*arguments, **options)
        response.headers.update(REVALIDATE)
        return response


def install(app: FastAPI) -> None:
    """Serve the pages and their files from `app`."""

    @app.api_route("/", methods=["GET", "HEAD"], include_in_schema=False)
    async def viewer() -> Response:
        return FileResponse(FOLDER / "index.html", headers=REVALIDATE)

    @app.api_route("/docs", methods=["GET", "HEAD"], include_in_schema=False)
    async def reference() -> Response:
        headers = REVALIDATE | {"Content-Security-Policy": DOCS_POLICY}
        return FileResponse(FOLDER / "docs.html", headers=headers)

    app.mount("/viewer", _Files(directory=FOLDER))

from __future__ import annotations

import ast
import errno
import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI, HTTPException
from sqlalchemy.exc import OperationalError

from service.api import error_handlers
from service.problems import CATALOGUE, Problem
from service.settings import Settings
from tests.support.service_process import Served


@pytest.fixture(scope="module")
def client() -> Iterator[httpx.Client]:
    app = FastAPI()
    app.state.settings = Settings()
    error_handlers.install(app)

    @app.get("/number/{value}")
    async def number(value: int) -> int:
        return value

    @app.get("/problem")
    async def problem() -> None:
        raise Problem("too_many_points", "Too many.", hint="Fewer.", limit=3, actual=4, headers={"Retry-After": "1"})

    @app.get("/http/{status}")
    async def http(status: int) -> None:
        raise HTTPException(status, "for some reason")

    @app.get("/database")
    async def database() -> None:
        raise OperationalError("SELECT secret", {}, Exception("secret"))

    @app.get("/disk/{number}")
    async def disk(number: int) -> None:
        raise OSError(number, "secret")

    @app.get("/bug")
    async def bug() -> None:
        raise ZeroDivisionError("secret")

    with Served(app) as client:
        yield client


@pytest.mark.parametrize(
    ("method", "path", "status", "code"),
    [
        ("GET", "/nothing", 404, "not_found"),
        ("PUT", "/problem", 405, "method_not_allowed"),
        ("GET", "/number/x", 422, "invalid_parameters"),
        ("GET", "/problem", 413, "too_many_points"),
        ("GET", "/http/413", 413, "upload_too_large"),
        ("GET", "/http/415", 415, "unsupported_media_type"),
        ("GET", "/http/429", 429, "too_many_requests"),
        ("GET", "/http/503", 503, "too_busy"),
        ("GET", "/http/418", 418, "bad_request"),
        ("GET", "/database", 503, "database_unavailable"),
        ("GET", f"/disk/{errno.ENOSPC}", 503, "disk_full"),
        ("GET", f"/disk/{errno.EROFS}", 503, "data_read_only"),
        ("GET", f"/disk/{errno.EIO}", 500, "internal_error"),
        ("GET", "/bug", 500, "internal_error"),
    ],
)
def test_one_shape(client: httpx.Client, method: str, path: str, status: int, code: str) -> None:
    response = client.request(method, path)
    body = response.json()
    assert response.status_code == status == body["status"]
    assert response.headers["content-type"] == "application/problem+json"
    assert body["code"] == code
    assert body["type"] == f"urn:pcdnf:problem:{code}"
    assert body["instance"] == path
    assert body["title"]
    assert body["hint"].endswith(".")
    assert body["detail"].endswith((".", "reason"))
    assert "secret" not in response.text


def test_members_and_headers(client: httpx.Client) -> None:
    response = client.get("/problem")
    assert response.headers["retry-after"] == "1"
    assert {"hint": "Fewer.", "limit": 3, "actual": 4}.items() <= response.json().items()


def test_validation_names_the_parameter(client: httpx.Client) -> None:
    body = client.get("/number/x").json()
    assert body["errors"][0]["parameter"] == "value"
    assert body["detail"].startswith("value: ")


def test_codes_are_snake_case_and_statuses_real() -> None:
    for code, (status, title) in CATALOGUE.items():
        assert re.fullmatch(r"[a-z]+(_[a-z]+)*", code)
        assert 400 <= status <= 599
        assert title


def raised() -> Iterator[tuple[str, ast.expr | None, ast.expr | None]]:
    """The place, the detail and the hint of every problem in the service's code."""
    root = Path(__file__).parents[2]
    for path in sorted((root / "service").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Problem":
                hint = next((keyword.value for keyword in node.keywords if keyword.arg == "hint"), None)
                yield f"{path.relative_to(root)}:{node.lineno}", node.args[1] if len(node.args) > 1 else None, hint


def texts(expression: ast.expr | None) -> list[str]:
    """The texts that an expression may have, with `0` for what is filled in; none for a variable."""
    if isinstance(expression, ast.IfExp):
        return texts(expression.body) + texts(expression.orelse)
    if isinstance(expression, ast.Constant):
        return [expression.value]
    if isinstance(expression, ast.JoinedStr):
        return ["".join(part.value if isinstance(part, ast.Constant) else "0" for part in expression.values)]
    return []


def test_every_problem_says_what_is_wrong_and_what_to_do() -> None:
    found = list(raised())
    assert len(found) > 50
    assert [place for place, detail, hint in found if detail is None or hint is None] == []
    odd = [
        (place, text)
        for place, detail, hint in found
        for text in texts(detail) + texts(hint)
        if not re.fullmatch(r"[A-Z0/-].*\S\.", text) and not re.fullmatch(r"[a-z_]+: .*[.0]", text)
    ]
    assert odd == []


def test_every_code_is_documented() -> None:
    page = (Path(__file__).parents[2] / "docs" / "api.md").read_text()
    for code, (status, title) in CATALOGUE.items():
        assert f"| `{code}` | {status} | {title} |" in page, code

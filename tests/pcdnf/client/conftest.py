"""A service, and a proxy before it that can be told to misbehave."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.misbehaving import Proxy, misbehaving
from tests.support.service_process import Service, write_sphere


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service of its own processes."""
    service = Service(tmp_path_factory.mktemp("client"), tile_points=2048).start()
    yield service
    assert service.stop() == 0


@pytest.fixture(scope="session")
def url(service: Service) -> str:
    """Its address."""
    return str(service.client.base_url).rstrip("/")


@pytest.fixture
def proxy(url: str) -> Iterator[Proxy]:
    """A proxy before it."""
    with misbehaving(url) as proxy:
        yield proxy


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    """A PLY of 1,500 points."""
    return write_sphere(tmp_path / "small scan.ply", 1500)


@pytest.fixture(autouse=True)
def _no_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PCDNF_URL", "PCDNF_API_KEY"):
        monkeypatch.delenv(name, raising=False)

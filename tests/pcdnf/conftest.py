"""What the tests of several modules share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from pcdnf.formats import FormatError, Limits, PointCloud, read
from tests.support.misbehaving import Proxy, misbehaving
from tests.support.service_process import write_sphere


@pytest.fixture
def refused(tmp_path: Path) -> Callable[..., FormatError]:
    """The error that the bytes of a file are refused with."""

    def refuse(data: bytes, **limits: Any) -> FormatError:
        path = tmp_path / "refused"
        path.write_bytes(data)
        with pytest.raises(FormatError) as caught:
            read(path, limits=Limits(**limits))
        assert str(caught.value).endswith((".", "…")), "a sentence"
        assert caught.value.hint
        return caught.value

    return refuse


@pytest.fixture
def two_threads() -> Iterator[None]:
    """Two threads of torch, whatever the machine has."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def load(tmp_path: Path) -> Callable[..., PointCloud]:
    """Reads a cloud from the bytes of a file."""

    def from_bytes(data: bytes, **limits: Any) -> PointCloud:
        path = tmp_path / "cloud.bin"
        path.write_bytes(data)
        return read(path, limits=Limits(**limits))

    return from_bytes


@pytest.fixture
def proxy(url: str) -> Iterator[Proxy]:
    """A proxy before the running service that can be told to misbehave."""
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

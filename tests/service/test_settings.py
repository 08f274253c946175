from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import ValidationError

from service.exposure import check_exposure, is_loopback
from service.settings import Settings, SettingsError
from service.settings_page import settings_table

DOCS = Path(__file__).parents[2] / "docs" / "settings.md"


def test_every_setting_is_documented() -> None:
    assert DOCS.read_text() == settings_table(), "run: python -m service.settings_page > docs/settings.md"


def test_every_setting_says_what_it_is_for() -> None:
    for name, field in Settings.model_fields.items():
        assert field.description, name
        assert field.description.endswith((".", ")")), name


def test_environment_and_empty_values(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PCDNF_MAX_POINTS", "1234")
    monkeypatch.setenv("PCDNF_WORKER_ID", "")
    monkeypatch.setenv("PCDNF_DATA_DIR", str(tmp_path))
    settings = Settings()
    assert settings.max_points == 1234
    assert settings.executor_id == "worker-0"
    assert settings.resolved_database_url == f"sqlite:///{tmp_path}/pcdnf.sqlite"


def test_a_wrong_value_is_not_told_with_its_password() -> None:
    for url in ("mysql://ada:secret@host/name", "postgresql://ada:secret@host:port/name"):
        with pytest.raises(ValidationError) as caught:
            Settings(database_url=url, max_points=0)
        assert "secret" not in str(caught.value)


def test_postgresql_url_and_worker_name() -> None:
    settings = Settings(database_url="postgresql://a:b@c/d")
    assert settings.resolved_database_url == "postgresql+psycopg://a:b@c/d"
    assert settings.executor_id.endswith("-0")
    assert settings.executor_id != "worker-0"


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost", "127.1.2.3"])
def test_loopback_needs_no_key(host: str) -> None:
    check_exposure(Settings(host=host))


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.1", "example.org"])
def test_elsewhere_needs_a_key(host: str, tmp_path: Path) -> None:
    assert not is_loopback(host)
    with pytest.raises(SettingsError, match=r"PCDNF_API_KEY.*PCDNF_ALLOW_ANONYMOUS"):
        check_exposure(Settings(host=host))
    check_exposure(Settings(host=host, api_key="a" * 16))
    check_exposure(Settings(host=host, api_keys_file=tmp_path / "keys"))
    check_exposure(Settings(host=host, allow_anonymous=True))


@pytest.mark.parametrize(
    ("name", "value"),
    [("device", "gpu"), ("precision", "float16"), ("database_url", "mysql://x"), ("port", 70000), ("api_key", "short")],
)
def test_refused_values(name: str, value: object) -> None:
    with pytest.raises(ValidationError):
        Settings(**{name: value})

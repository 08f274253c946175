"""Who can reach the service, and whether a key protects it."""

from __future__ import annotations

import ipaddress

from .settings import Settings, SettingsError


def check_exposure(settings: Settings) -> None:
    """Check that the service is not open to the network or to other sites without a key.

    Raises
    ------
    SettingsError
    """
    if settings.origins and not settings.has_keys:
        raise SettingsError(
            "PCDNF_ALLOWED_ORIGINS would let pages of other sites use a service without keys. Set PCDNF_API_KEY "
            "or PCDNF_API_KEYS_FILE."
        )
    if settings.callback_host_names and not settings.callback_secret:
        raise SettingsError(
            "PCDNF_CALLBACK_HOSTS needs a secret to sign the messages with. Set PCDNF_CALLBACK_SECRET to at least "
            "32 random characters."
        )
    if is_loopback(settings.host) or settings.allow_anonymous or settings.has_keys:
        return
    raise SettingsError(
        f"Refusing to listen on {settings.host} without a key. Set PCDNF_API_KEY or PCDNF_API_KEYS_FILE, listen on "
        "127.0.0.1, or set PCDNF_ALLOW_ANONYMOUS=true if a proxy authenticates the callers."
    )


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach `host`."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False

"""The choice of storage by its URL."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import unquote, urlsplit

from ..settings import Settings, SettingsError
from .base import Storage, StorageError
from .local import LocalStorage


def open_storage(settings: Settings, *, patience: float) -> Storage:
    """Return the storage in the settings; :meth:`Storage.check` checks that it can be reached.

    Parameters
    ----------
    settings : Settings
    patience : float
        Seconds that a request to a storage elsewhere is tried again.

    Raises
    ------
    SettingsError
        If the storage cannot be used.
    """
    url = settings.storage_url or settings.data_dir.absolute().as_uri()
    try:
        if url.startswith("file:"):
            return LocalStorage(Path(unquote(urlsplit(url).path)))
        from .s3 import BucketStorage  # only where one is used

        return BucketStorage(url, settings.data_dir, patience=patience)
    except (StorageError, OSError) as error:
        reason = str(error).rstrip(".")
        raise SettingsError(f"{url} cannot be used as storage: {reason}. Check PCDNF_STORAGE_URL.") from error

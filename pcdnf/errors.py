"""The exceptions of this package.

::

    PcdnfError                 a message, a stable ``code`` and a ``hint`` that says what to do
    ├── FormatError            a file cannot be read, or a cloud cannot be written (formats)
    ├── CheckpointError        a model cannot be found, read, trusted or written (models.catalog)
    ├── CloudError             these points cannot be denoised (inference.unit_frame)
    ├── ChoiceError            these iterations, radius, initial normals or speed cannot be used (inference.options)
    ├── DeviceError            the device or precision does not exist, or its memory is too small (inference.device)
    ├── MissingExtraError      a library of an optional part is not installed
    ├── UnreachableError       the service did not answer (client.errors)
    └── ProblemError           the service answered with a problem (client.errors)
        └── JobError           the job ended without a result (client.errors)

``pcdnf.Stopped`` stands outside of the tree: it is raised when the caller asked to stop.
"""

from __future__ import annotations


class PcdnfError(Exception):
    """An error a caller can act on.

    Parameters
    ----------
    message : str
        One or more full sentences for a person.
    code : str
        Stable snake-case identifier for programs.
    hint : str, optional
        What to do about it.
    """

    def __init__(self, message: str, *, code: str, hint: str | None = None) -> None:
        super().__init__(message)
        self.code = code
        self.hint = hint


class MissingExtraError(PcdnfError, ImportError):
    """A part of this package whose libraries were not installed."""

    def __init__(self, message: str, *, extra: str) -> None:
        super().__init__(message, code="missing_extra", hint=f"Run: pip install 'pcdnf[{extra}]'")


MissingExtra = MissingExtraError
"""The older name."""

EXTRA_OF = {
    "numba": "denoise",
    "PIL": "denoise",
    "safetensors": "denoise",
    "scipy": "denoise",
    "torch": "denoise",
    "tqdm": "denoise",
    "manifold3d": "train",
    "skimage": "train",
    "trimesh": "train",
    "matplotlib": "benchmark",
    "dbos": "service",
    "fastapi": "service",
    "pydantic_settings": "service",
}
"""Libraries that a base install lacks, and the extra that brings each."""


def missing_extra(error: ModuleNotFoundError) -> ImportError:
    """Return the error to raise for a module that was not found.

    Parameters
    ----------
    error : ModuleNotFoundError
        As the import raised it.

    Returns
    -------
    ImportError
        A :class:`MissingExtraError` if the module belongs to an extra of this package, else ``error`` itself.
    """
    library = (error.name or "").partition(".")[0]
    if library not in EXTRA_OF:
        return error
    return MissingExtraError(f"This needs {library}, which is not installed.", extra=EXTRA_OF[library])

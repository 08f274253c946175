"""The exceptions of this package.

PcdnfError                 a message that says what is wrong, a stable ``code``, a ``hint`` that says what to do
├── formats.FormatError    a file that cannot be read, or a cloud that cannot be written
├── checkpoint.CheckpointError   a model that cannot be found, read, trusted or written
├── cloud.CloudError       points that cannot be denoised
├── choices.ChoiceError    iterations, a radius, raw normals or a form that cannot be used
├── device.DeviceError     a device or precision that is not there, or has no room
├── MissingExtra           libraries that were not installed
└── client.errors          Unreachable, ProblemError and its JobError: of a service
``denoiser.Stopped`` is not an error: it is raised when the caller asked to stop.
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


class MissingExtra(PcdnfError, ImportError):
    """A part of this package whose libraries were not installed."""

    def __init__(self, message: str, *, extra: str) -> None:
        super().__init__(message, code="missing_extra", hint=f"Run: pip install 'pcdnf[{extra}]'")

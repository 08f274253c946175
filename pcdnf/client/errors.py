"""The exceptions of the client.

PcdnfError
├── UnreachableError  no answer came: no connection, a broken one, or silence
└── ProblemError      the service answered with a problem
    └── JobError      the job ended without a result

``Unreachable`` is the older name of ``UnreachableError``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..errors import PcdnfError

if TYPE_CHECKING:
    from .schemas import ProblemDetail


class UnreachableError(PcdnfError):
    """The service gave no answer."""


Unreachable = UnreachableError


class ProblemError(PcdnfError):
    """An error the service answered with.

    Attributes
    ----------
    code, hint : str
        As the service gave them; ``http_<status>`` where something in between answered.
    status : int
        The HTTP status.
    problem : ProblemDetail
        All of it.
    retry_after : float or None
        Seconds after which the service wants to be asked again.
    """

    def __init__(self, problem: ProblemDetail, *, retry_after: float | None = None) -> None:
        super().__init__(problem.detail, code=problem.code, hint=problem.hint)
        self.problem = problem
        self.status = problem.status
        self.retry_after = retry_after


class JobError(ProblemError):
    """A job that failed or was cancelled.

    Attributes
    ----------
    job_id : str
    """

    def __init__(self, problem: ProblemDetail, job_id: str) -> None:
        super().__init__(problem)
        self.job_id = job_id

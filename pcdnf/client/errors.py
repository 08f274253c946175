"""The exceptions of the client.

PcdnfError
├── UnreachableError  no answer came: no connection, a lost connection, or a timeout
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
        As in the service's answer; ``http_<status>`` if a proxy answered instead.
    status : int
        The HTTP status.
    problem : ProblemDetail
        The whole answer.
    retry_after : float or None
        Seconds to wait before the next attempt, if the service named them.
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

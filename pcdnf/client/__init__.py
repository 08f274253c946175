"""A client of the service: upload a cloud, follow its job, fetch the result.

>>> from pcdnf.client import Client
>>> with Client("http://127.0.0.1:8000") as client:
...     job = client.denoise("scan.ply", "clean.ply", iterations=3)

Needs the extra ``client`` (httpx, pydantic) and nothing that denoises. Short refusals (429, 503) and lost connections
are waited out; a request that is repeated never makes a second job.
"""

from ..errors import MissingExtraError

try:
    import httpx as _httpx  # noqa: F401
    import pydantic as _pydantic  # noqa: F401
except ModuleNotFoundError as error:
    raise MissingExtraError(f"pcdnf.client needs {error.name}, which is not installed.", extra="client") from error

from .client import Client
from .errors import JobError, ProblemError, Unreachable, UnreachableError
from .schemas import Execution, Job, Model, Plan, ProblemDetail, Progress
from .transport import DEFAULT_URL

__all__ = [
    "DEFAULT_URL",
    "Client",
    "Execution",
    "Job",
    "JobError",
    "Model",
    "Plan",
    "ProblemDetail",
    "ProblemError",
    "Progress",
    "Unreachable",
    "UnreachableError",
]

"""A client of the service: upload a cloud, wait for its job, download the result.

>>> from pcdnf.client import Client
>>> with Client("http://127.0.0.1:8000") as client:
...     job = client.denoise("scan.ply", "clean.ply", iterations=3)

Needs the extra ``client`` (httpx, pydantic) and nothing that denoises. After temporary errors (429, 503, lost
connections) a request is repeated; that never creates a second job.
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

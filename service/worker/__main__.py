"""``python -m service.worker``: the worker process."""

from .main import main

main()

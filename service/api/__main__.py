"""``python -m service.api``: the API process."""

from .server import main

main()

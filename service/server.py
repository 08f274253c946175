"""``python -m service.server``: the API process, under the name that older compose files use."""

from .api.server import main

if __name__ == "__main__":
    main()

"""``python -m service.server``: the API process, under the name that compose files used before version 0.2."""

from .api.server import main

if __name__ == "__main__":
    main()

"""``python -m service.server``: the command of the API process in compose files written before 0.2."""

from .api.server import main

if __name__ == "__main__":
    main()

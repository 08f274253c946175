"""Print what the service of the image needs, one requirement a line, as the project's metadata declares it."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path


def service_requirements(pyproject: Path) -> list[str]:
    """Return the dependencies of ``pcdnf[service,las]`` in the order ``pyproject.toml`` lists them."""
    project = tomllib.loads(pyproject.read_text())["project"]
    extras = project["optional-dependencies"]
    return [*project["dependencies"], *extras["service"], *extras["las"]]


if __name__ == "__main__":
    print("\n".join(service_requirements(Path(sys.argv[1]))))

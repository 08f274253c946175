"""Print what the service of the image needs, one requirement a line, as the project's metadata declares it."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

EXTRAS = ("denoise", "service", "las")


def service_requirements(pyproject: Path) -> list[str]:
    """Return the dependencies of ``pcdnf[denoise,service,las]`` in the order ``pyproject.toml`` lists them."""
    project = tomllib.loads(pyproject.read_text())["project"]
    extras = project["optional-dependencies"]
    lines = [*project["dependencies"], *(line for extra in EXTRAS for line in extras[extra])]
    return [line for line in lines if not line.startswith(f"{project['name']}[")]


if __name__ == "__main__":
    print("\n".join(service_requirements(Path(sys.argv[1]))))

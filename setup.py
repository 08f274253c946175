"""The one part of the metadata that pyproject.toml cannot express: a README whose links work outside the repository.

Everything else is declared in pyproject.toml. docs/decisions.md ("The README of the package") says why.
"""

import re
import tomllib
from pathlib import Path

from setuptools import setup

ROOT = Path(__file__).parent
LINK = re.compile(r"(?P<image>!?)\[(?P<text>[^\]]*)\]\((?!https?://|#)(?P<path>[^)]+)\)")


def portable_readme(text: str, repository: str | None) -> str:
    """Replace the relative links of a README.

    Parameters
    ----------
    text : str
        Markdown with links relative to the root of the repository.
    repository : str or None
        Address of the public repository. Without one a link becomes its text and a picture is left out.
    """

    def replaced(link: re.Match[str]) -> str:
        if repository is None:
            return "" if link["image"] else link["text"]
        kind = "raw" if link["image"] else "blob"
        return f"{link['image']}[{link['text']}]({repository.rstrip('/')}/{kind}/HEAD/{link['path']})"

    return LINK.sub(replaced, text)


if __name__ == "__main__":
    urls = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    setup(
        long_description=portable_readme(readme, urls.get("Repository")),
        long_description_content_type="text/markdown",
    )

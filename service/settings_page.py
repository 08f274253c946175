"""The page ``docs/settings.md``: ``python -m service.settings_page > docs/settings.md`` writes it anew."""

from __future__ import annotations

from .settings import Settings


def settings_table() -> str:
    """Return the Markdown of ``docs/settings.md``."""
    rows = [
        "# Settings",
        "",
        "The service reads its settings from the environment. This page is written from `service/settings.py` by",
        "`python -m service.settings_page > docs/settings.md`.",
        "",
        "| Variable | Default | Meaning |",
        "|---|---|---|",
    ]
    for name, field in Settings.model_fields.items():
        default = "" if field.default is None else f"`{_shown(field.default)}`"
        rows.append(f"| `PCDNF_{name.upper()}` | {default} | {field.description} |")
    return "\n".join(rows) + "\n"


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    print(settings_table(), end="")

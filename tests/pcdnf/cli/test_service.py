"""The commands of the service are listed by ``pcdnf`` and completed by the service when they run."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcdnf.cli.main import build_parser
from pcdnf.cli.service import COMMANDS
from tests.support.blocked import run_without


def test_help_lists_them(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        build_parser().parse_args(["--help"])
    shown = capsys.readouterr().out
    assert [what for what in COMMANDS.values() if what not in " ".join(shown.split())] == []


@pytest.mark.parametrize("command", COMMANDS)
def test_the_service_adds_its_options(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        build_parser(command=command).parse_args([command, "--help"])
    assert "--data-dir" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["--help", "models", "denoise --help"])
def test_other_commands_do_not_import_the_service(command: str, tmp_path: Path) -> None:
    program = (
        "import sys\nfrom pcdnf.cli.main import main\n"
        f"try:\n    main({command.split()!r})\nexcept SystemExit:\n    pass\n"
        "assert not [name for name in sys.modules if name.partition('.')[0] == 'service']"
    )
    done = run_without([], program, tmp_path)
    assert done.returncode == 0, done.stderr


def test_a_library_that_the_service_lacks_is_named(tmp_path: Path) -> None:
    program = "from pcdnf.cli.main import main\nraise SystemExit(main(['doctor']))"
    done = run_without(["pydantic_settings"], program, tmp_path)
    assert done.returncode == 2
    assert "pip install 'pcdnf[service]'" in done.stderr

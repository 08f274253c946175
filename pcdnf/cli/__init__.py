"""The command line: one module a command, wired by :mod:`pcdnf.cli.main`."""

from .main import main as main

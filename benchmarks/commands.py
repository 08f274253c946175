"""Seconds of the commands that read no cloud: the best of several runs, of the wall and of the processor.

    python benchmarks/commands.py [--runs 7]

The first line is Python itself, which is part of all others.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time

COMMANDS = ("--version", "--help", "models", "serve --help", "doctor --help")


def seconds(arguments: list[str]) -> tuple[float, float]:
    """Wall and processor time of one run of Python."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=7)
    runs = parser.parse_args().runs
    print("| command | seconds | of the processor |\n|---|---|---|")
    programs = {"python -c pass": ["-c", "pass"]}
    programs |= {f"pcdnf {command}": ["-m", "pcdnf.cli", *command.split()] for command in COMMANDS}
    for name, arguments in programs.items():
        wall, processor = (min(times) for times in zip(*(seconds(arguments) for _ in range(runs)), strict=True))
        print(f"| `{name}` | {wall:.2f} | {processor:.2f} |")


if __name__ == "__main__":
    main()

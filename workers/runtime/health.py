"""Probe for engines: is a remote worker in contact with its broker? `python -m workers.runtime.health FILE`.

Exit status 0 or 1, with one line that states the reason. FILE is the worker's `--health` file: its name and the time
of the broker's last answer, or of the last progress of a job (CLOCK_MONOTONIC). A probe starts often, so this module
imports only the standard library.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

WITHIN_S = 30.0  # default limit of the age; longer than a job that shows no progress may last (15 s)


def main() -> None:
    given = parser().parse_args()
    healthy, reason = check(given.file, given.within, time.monotonic())
    print(reason)
    sys.exit(0 if healthy else 1)


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(prog="python -m workers.runtime.health", description="Probe of a remote worker.")
    made.add_argument("file", type=Path, metavar="FILE", help="health file of the worker (its option --health)")
    made.add_argument(
        "--within", type=float, default=WITHIN_S, metavar="S", help="limit of the age (s); default: %(default)g"
    )
    return made


def check(file: Path, within_s: float, now: float) -> tuple[bool, str]:
    """(in contact, reason). `now`: CLOCK_MONOTONIC in s, of the machine on which the worker runs."""
    try:
        text = file.read_text()
    except OSError as error:
        return False, f"the worker is not running, or it has no --health {file}: {error.strerror}"
    if not text:
        return False, "the broker has not answered yet"
    try:
        worker, at = text.split()
        age_s = now - float(at)
    except ValueError:
        return False, f"{file} is not a health file of a worker"
    if age_s < 0.0:
        return False, f"{worker} wrote {file} before this machine was restarted"
    words = f"the broker answered {worker} {age_s:.1f} s ago"
    return (True, words) if age_s <= within_s else (False, f"{words}; the limit is {within_s:g} s")


if __name__ == "__main__":
    main()

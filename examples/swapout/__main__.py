"""Perform the swap-out on its own cluster, in physics: `python -m examples.swapout [--part insertion] [--test]`.

Run it from the checkout. Exit status 0 only if every check against the simulator's truth passed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rich.console import Console

from examples.swapout import swapout
from rtc.protocol.outcomes import RtcError


def main() -> int:
    words = argparse.ArgumentParser(prog="python -m examples.swapout", description=swapout.__doc__)
    words.add_argument("--speed", default="1", type=_speed, help="simulated seconds per second, or max")
    words.add_argument("--out", default=Path("out"), type=Path, help="directory of the pictures and of the film")
    words.add_argument("--test", action="store_true", help="all lines on paper first")
    words.add_argument("--part", default="", choices=sorted(swapout.PARTS), help="a part of the task")
    given = words.parse_args()
    try:
        return 0 if swapout.run(Console(), given.speed, given.out, test=given.test, part=given.part) else 1
    except RtcError as error:
        words.exit(1, f"{error}\n")


def _speed(text: str) -> str:
    """As `own_cluster` takes it. Raises ValueError."""
    return text if text == "max" else str(float(text))


if __name__ == "__main__":
    sys.exit(main())

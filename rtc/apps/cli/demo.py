"""rtc demo: run a scenario on its own cluster."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

import rtc
from rtc.apps.cli.cluster import speed_of
from rtc.apps.cli.output import cli_error, console, exits_with
from rtc.protocol.spelling import unknown

CHECKOUT = Path(rtc.__file__).resolve().parents[1]
EXAMPLES = ["swapout"] if (CHECKOUT / "examples" / "swapout").is_dir() else []  # a wheel has none of them
DEMOS = ["grasp", *EXAMPLES]


def demo(
    name: Annotated[str, typer.Argument(help=f"One of: {', '.join(DEMOS)}.", autocompletion=lambda: DEMOS)] = "grasp",
    speed: Annotated[str, typer.Option(help="Simulated seconds per second, or max.")] = "1",
    out: Annotated[Path, typer.Option(help="Directory of the pictures.")] = Path("out"),
    test: Annotated[bool, typer.Option("--test", help="swapout: all lines on paper first.")] = False,
    part: Annotated[str, typer.Option(help="swapout: a part of the task, such as insertion.")] = "",
) -> None:
    """Start a cluster, run a scenario with a commentary, check it against the simulator, stop everything.

    Exit status 0 only if every check passed. The swap-out is an example, so it is there in a checkout alone.

    Example:  rtc demo grasp
    Example:  rtc demo swapout --speed max --part insertion
    """
    if name not in DEMOS:
        raise cli_error(unknown("demo", name, DEMOS), 2)
    speed_of(speed)
    if name in EXAMPLES:
        _become(name, speed, out, (["--test"] if test else []) + (["--part", part] if part else []))
    if test or part:
        raise cli_error(f"--test and --part are for the demo swapout, not for {name}", 2)
    from rtc.apps.demos import grasp

    with exits_with(1):
        passed = grasp.run(console, speed, out)
    if not passed:
        raise typer.Exit(1)


def _become(example: str, speed: str, out: Path, more: list[str]) -> None:
    """Continue as the program of this example. In place of this process, so that a signal reaches its cluster."""
    words = [sys.executable, "-m", f"examples.{example}", "--speed", speed, "--out", str(out.absolute()), *more]
    os.chdir(CHECKOUT)
    os.execv(sys.executable, words)

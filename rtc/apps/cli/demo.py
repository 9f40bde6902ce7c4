"""rtc demo: run a scenario on its own cluster. Each scenario is a file in rtc/apps/demos/."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from rtc.apps.cli.cluster import speed_of
from rtc.apps.cli.output import cli_error, console, exits_with
from rtc.language.alike import unknown

DEMOS = ["grasp", "swapout"]  # modules of rtc.apps.demos, each with `run(console, speed, out) -> passed`


def demo(
    name: Annotated[str, typer.Argument(help=f"One of: {', '.join(DEMOS)}.", autocompletion=lambda: DEMOS)] = "grasp",
    speed: Annotated[str, typer.Option(help="Simulated seconds per second, or max.")] = "1",
    out: Annotated[Path, typer.Option(help="Directory of the pictures.")] = Path("out"),
    test: Annotated[bool, typer.Option("--test", help="swapout: all lines on paper first.")] = False,
    part: Annotated[str, typer.Option(help="swapout: a part of the task, such as insertion.")] = "",
) -> None:
    """Start a cluster, run a scenario with a commentary, check it against the simulator, stop everything.

    Exit status 0 only if every check passed.

    Example:  rtc demo grasp
    Example:  rtc demo swapout --speed max
    Example:  rtc demo swapout --speed max --part insertion
    """
    if name not in DEMOS:
        raise cli_error(unknown("demo", name, DEMOS), 2)
    speed_of(speed)
    module = import_module(f"rtc.apps.demos.{name}")
    parts = getattr(module, "PARTS", {})
    if (test or part) and not parts:
        raise cli_error(f"--test and --part are for the demo swapout, not for {name}", 2)
    if part and part not in parts:
        raise cli_error(unknown("part", part, sorted(parts)), 2)
    more = {"test": test, "part": part} if parts else {}
    with exits_with(1):
        passed = module.run(console, speed, out, **more)
    if not passed:
        raise typer.Exit(1)

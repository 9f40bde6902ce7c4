"""rtc demo: run a scenario on its own cluster."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rtc.apps.cli.cluster import speed_of
from rtc.apps.cli.output import cli_error, console, exits_with
from rtc.language.alike import unknown

DEMOS = ["grasp"]


def demo(
    name: Annotated[str, typer.Argument(help=f"One of: {', '.join(DEMOS)}.", autocompletion=lambda: DEMOS)] = "grasp",
    speed: Annotated[str, typer.Option(help="Simulated seconds per second, or max.")] = "1",
    out: Annotated[Path, typer.Option(help="Directory of the pictures.")] = Path("out"),
) -> None:
    """Start a cluster, run a scenario with a commentary, check it against the simulator, stop everything.

    Exit status 0 only if every check passed. The swap-out is an example: python -m examples.swapout, in a checkout.

    Example:  rtc demo grasp
    """
    if name not in DEMOS:
        raise cli_error(unknown("demo", name, DEMOS), 2)
    speed_of(speed)
    from rtc.apps.demos import grasp

    with exits_with(1):
        passed = grasp.run(console, speed, out)
    if not passed:
        raise typer.Exit(1)

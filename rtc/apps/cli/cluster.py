"""rtc up, down: start and stop a cluster, which is the work of the supervisor (`python -m deploy`)."""

from __future__ import annotations

import math
import os
import signal
import sys
from pathlib import Path
from typing import Annotated, cast

import msgspec
import typer

from rtc.apps.cli.output import RunDir, cli_error, duration_s
from rtc.runtime.settings import MAX_DIM, MAX_REMOTE_WORKERS, MAX_WORKERS, MCMS, MIN_DIM, Mcm, Settings, default_run_dir

DEFAULT = Settings(run_dir="")  # the defaults of `rtc up`


def up(
    cell: Annotated[str, typer.Option(help="Name of a cell that comes with rtc, or a cell file.")] = DEFAULT.cell,
    dim: Annotated[
        int, typer.Option(min=MIN_DIM, max=MAX_DIM, help="Dimension of the cube: 2^dim workers.")
    ] = DEFAULT.dim,
    least: Annotated[
        int | None,
        typer.Option(min=0, max=MAX_WORKERS, help="Workers of each kind when idle.", show_default="the cube's"),
    ] = DEFAULT.least_workers,
    most: Annotated[
        int, typer.Option(min=1, max=MAX_WORKERS, help="Workers of each kind while jobs wait.")
    ] = DEFAULT.most_workers,
    mcm: Annotated[str, typer.Option(help="bullet (physics) or kinematic (exact, no physics).")] = DEFAULT.mcm,
    speed: Annotated[str, typer.Option(help="Simulated seconds per second, or max.")] = f"{DEFAULT.speed:g}",
    listen: Annotated[
        str, typer.Option(help="tcp://HOST:PORT: admit holders of a key (rtc keys) from other machines.")
    ] = DEFAULT.listen,
    more: Annotated[
        str, typer.Option(help="Command line that starts {count} workers of a {kind} elsewhere (rtc docs security).")
    ] = DEFAULT.more,
    more_max: Annotated[
        int, typer.Option(min=1, max=MAX_REMOTE_WORKERS, help="With --more: workers of each kind elsewhere.")
    ] = DEFAULT.scale_out_max,
    more_wait: Annotated[
        str, typer.Option(help="With --more: time for them to join; then they are asked for again.")
    ] = f"{DEFAULT.scale_out_timeout_s:g}s",
    record: Annotated[
        bool, typer.Option("--record", help="Record the run in the current directory: rtc-DATE-TIME.mcap.")
    ] = False,
    run_dir: RunDir = None,
    detach: Annotated[bool, typer.Option("-d", "--detach", help="Return once it is ready.")] = False,
) -> None:
    """Start a cluster; without -d it stays in the foreground until Ctrl-C.

    Example:  rtc up -d --mcm kinematic --speed max
    Example:  rtc up -d --listen tcp://192.168.1.5:5555
    """
    if mcm not in MCMS:
        raise cli_error(f"--mcm is {' or '.join(MCMS)}, not {mcm}", 2)
    settings = Settings(
        run_dir=str(run_dir or default_run_dir()),
        cell=cell,
        dim=dim,
        least_workers=least,
        most_workers=most,
        mcm=cast(Mcm, mcm),
        speed=speed_of(speed),
        listen=listen,
        more=more,
        scale_out_max=more_max,
        scale_out_timeout_s=duration_s(more_wait, "--more-wait"),
        record=str(Path.cwd()) if record else "",
    )
    _become_deploy("up", *(["-d"] if detach else []), "--", msgspec.json.encode(settings).decode())


def down(run_dir: RunDir = None) -> None:
    """Stop the cluster in order.

    Example:  rtc down
    """
    _become_deploy("down", "--", str(run_dir or default_run_dir()))


def speed_of(text: str) -> float:
    """Simulated seconds per second; 0 for `max`. Raises typer.Exit, with the reason printed, if it is not a speed."""
    try:
        speed = 0.0 if text == "max" else float(text)
    except ValueError:
        speed = math.nan
    if not (0 < speed < math.inf or text == "max"):
        raise cli_error(f"--speed is a number above 0, or max; not {text}", 2)
    return speed


def _become_deploy(*arguments: str) -> None:
    """Become the supervisor's process: same terminal, same Ctrl-C, same exit status."""
    sys.stdout.flush()
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # the supervisor unblocks it when it can handle it
    os.execv(sys.executable, [sys.executable, "-P", "-m", "deploy", *arguments])

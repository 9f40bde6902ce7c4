"""rtc chaos: kill or stop processes of the running cluster, to test that work survives it."""

from __future__ import annotations

import random
import time
from typing import Annotated

import typer
from rich.text import Text

from rtc.apps.cli.output import AsJson, RunDir, cli_error, console, duration_s, emit_json, exits_with, table
from rtc.runtime.chaos import VICTIMS, Chaos, Strike
from rtc.runtime.process_table import processes
from rtc.runtime.settings import default_run_dir
from rtc.wording.measured import seconds

BACK_LIMIT_S = 30.0  # for the last killed process to be ready again
LOOK_S = 0.01


def chaos(
    kill: Annotated[str, typer.Option(help=f"Which: {', '.join(VICTIMS)}.")] = "any",
    every: Annotated[str, typer.Option(help="How often: 2s, 500ms.")] = "2s",
    for_: Annotated[str, typer.Option("--for", help="How long: 60s, 5m.")] = "60s",
    stop: Annotated[
        bool, typer.Option("--stop", help="SIGSTOP instead of SIGKILL: the process hangs and must be detected.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of the random choice.")] = 0,
    run_dir: RunDir = None,
    json: AsJson = False,
) -> None:
    """Kill random processes of the running cluster; report each and the time until its successor is ready.

    Commands continue, except those in motion when the MCM is killed: they end LOST SUBSYSTEM.

    Exit status 0 if every process was restarted.

    Example:  rtc chaos --kill worker --every 2s --for 60s
    """
    if kill not in VICTIMS:
        raise cli_error(f"--kill is one of {', '.join(VICTIMS)}; not {kill}", 2)
    every_s, for_s = duration_s(every, "--every"), duration_s(for_, "--for")
    maker = Chaos(run_dir or default_run_dir(), random.Random(seed), stop)
    processes(run_dir or default_run_dir())  # raises NoCluster before anything is announced
    begun_s = time.monotonic()
    word = "stopped" if stop else "killed"
    with exits_with(1):
        does = "stops" if stop else "kills"
        console.print(
            f"{does} a process ({kill}) every {seconds(every_s)} for {seconds(for_s)}, seed {seed}; Ctrl-C ends it"
        )
        try:
            _run(maker, kill, word, begun_s, every_s, for_s)
        except KeyboardInterrupt:
            console.print("finished; waiting for restarting processes")
        _await(maker, begun_s)
        _summary(maker)
        if json:
            emit_json({"seed": seed, "strikes": maker.strikes, "missing": [strike.name for strike in maker.missing]})
    if maker.missing:
        raise typer.Exit(1)


def _run(maker: Chaos, kind: str, word: str, begun_s: float, every_s: float, for_s: float) -> None:
    next_s = begun_s
    while (now := time.monotonic()) < begun_s + for_s:
        if now >= next_s:
            next_s += every_s
            strike = maker.strike(kind)
            _report(
                begun_s, f"{word} {strike.name} (pid {strike.pid})" if strike else f"there is no {kind} to be {word}"
            )
        _report_returned(maker, begun_s)
        time.sleep(LOOK_S)


def _await(maker: Chaos, begun_s: float) -> None:
    limit_s = time.monotonic() + BACK_LIMIT_S
    while maker.missing and time.monotonic() < limit_s:
        _report_returned(maker, begun_s)
        time.sleep(LOOK_S)


def _report_returned(maker: Chaos, begun_s: float) -> None:
    for strike in maker.returned():
        _report(begun_s, f"    {strike.name} is back after {seconds(strike.back_s or 0.0)} (pid {strike.new_pid})")


def _report(begun_s: float, text: str) -> None:
    console.print(Text(f"{time.monotonic() - begun_s:6.1f} s  ", style="dim") + Text(text))


def _summary(maker: Chaos) -> None:
    by_name: dict[str, list[Strike]] = {}
    for strike in maker.strikes:
        by_name.setdefault(strike.name, []).append(strike)
    out = table("process", "struck>", "back>", "median>", "worst>")
    for name, strikes in sorted(by_name.items()):
        back = sorted(strike.back_s for strike in strikes if strike.back_s is not None)
        figures = (seconds(back[len(back) // 2]), seconds(back[-1])) if back else ("-", "-")
        out.add_row(name, str(len(strikes)), str(len(back)), *figures)
    console.print(out)
    for strike in maker.missing:
        console.print(Text(f"{strike.name} did not come back within {BACK_LIMIT_S:g} s", style="bold red"))

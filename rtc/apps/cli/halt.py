"""rtc halt: stop motion from the shell. It imports little, so that it starts fast."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
import zmq
from rich.console import Console
from rich.text import Text

from rtc.apps.cli.output import AsJson, RunDir, With, console, emit_json, errors, exits_with
from rtc.apps.cli.stdio import OutputClosed
from rtc.client.halt import HALT_ENDPOINTS, HaltLine, HaltResult
from rtc.client.liveness import is_listening, not_running
from rtc.protocol.messages import CommandRecord, Phase
from rtc.protocol.outcomes import NoCluster, RtcError
from rtc.runtime.keys import Endpoints, KeyFile
from rtc.runtime.settings import Settings, default_run_dir

NOT_CONFIRMED = 3
MOVES = (Phase.EXECUTING, Phase.HALTING)
SETTLED_S, SETTLED = 0.05, " (but a hand still pressed, or a touch still gave way)"
LATE_S = 0.2  # an MCM that answers later may have been restarted and have lost a motion


def halt(
    scope: Annotated[str, typer.Argument(help="ALL, an arm by its name, or a command (C-7).")] = "ALL",
    timeout: Annotated[float, typer.Option(min=0.01, help="Seconds to wait for rest.")] = 2.0,
    json: AsJson = False,
    run_dir: RunDir = None,
    key: With = None,
) -> None:
    """Stop motion now, also without a broker: it bypasses every queue. Exit status 0 only when rest is confirmed.

    The printed latency is the time from this order to the first decelerating tick of a joint. For a cluster on another
    machine it ends with the arrival of its report.

    Example:  rtc halt
    Example:  rtc halt RIGHT-ARM
    """
    with _halt_line(run_dir or default_run_dir(), key) as line:
        result = line.halt(scope, timeout_s=timeout)
    code = 0 if result.confirmed else NOT_CONFIRMED
    if json:
        with exits_with(code):
            emit_json(result)
    else:
        print_halt(result)
        if not result.reached and not result.declined and "halt" in result.sent_to and scope.upper().startswith("C-"):
            _print_not_reached(scope.upper(), run_dir, key)
    raise typer.Exit(code)


@contextmanager
def _halt_line(run_dir: Path, key: Path | None) -> Iterator[HaltLine]:
    """A halt line. For a local cluster it needs two sockets but no files, so deleted files cannot prevent a halt.

    Raises NoCluster if no process listens.
    """
    if key is None:
        try:
            there = is_listening(run_dir, HALT_ENDPOINTS)
        except PermissionError:
            raise NoCluster(f"the cluster in {run_dir} belongs to another user; choose another --run-dir") from None
        if not there:
            raise not_running(run_dir)
        endpoints: Endpoints = _settings(run_dir.absolute())
    else:
        endpoints = KeyFile.load(key)
    with zmq.Context() as context:
        line = HaltLine(context, endpoints)
        try:
            yield line
        finally:
            line.close()


def _settings(run_dir: Path) -> Settings:
    """The settings of the cluster; without its file those of any cluster, whose broker passes the halt on."""
    try:
        return msgspec.structs.replace(Settings.load(run_dir), run_dir=str(run_dir))
    except (OSError, msgspec.MsgspecError):
        return Settings(run_dir=str(run_dir))


def print_halt(result: HaltResult, out: Console = console) -> None:
    """Print the result of a halt; on stderr if `out` is broken."""
    try:
        _print(result, out)
    except OutputClosed:
        _print(result, errors)


def _print_not_reached(command: str, run_dir: Path | None, key: Path | None) -> None:
    """Ask the broker about a command that the halt did not reach; print nothing if it does not answer."""
    from rtc.client.client import Client  # its import is slow, and the halt itself does not need it

    with suppress(RtcError, OutputClosed), Client(run_dir, key=key) as rtc:
        console.print(Text(not_reached(rtc.trace(command), rtc.status()["commands"])))


def not_reached(record: CommandRecord, commands: list[dict[str, Any]]) -> str:
    """The state of a command that moves nothing, and what moves instead. `commands`: rows of the status."""
    if record.outcome is None:
        state = f"{record.command} is {record.phase.value} and moves nothing"
    else:
        state = f"{record.command} has ended: {record.outcome.kind.value.replace('_', ' ')}"
    others = [row for row in commands if row["phase"] in MOVES and row["command"] != record.command]
    moving = [f"{row['command']} ({', '.join(row['resources'])}): rtc halt {row['command']}" for row in others]
    return f"{state}; " + (f"in motion: {'; '.join(moving)}" if moving else "no command is in motion")


def _print(result: HaltResult, out: Console) -> None:
    line = Text(f"HALT {result.scope}: ", style="bold")
    if result.declined:
        line.append(f"NOTHING HALTED: {result.message}", style="bold white on red")
    elif result.latency_s is None:
        line.append(f"REST NOT CONFIRMED: {result.message}", style="bold white on red")
    else:
        nothing = f"nothing of {result.scope} moves: it has ended, or has not begun"
        late = "nothing moves; it is not known whether something moved at the call"
        rest = max((sub.rest_s for sub in result.subsystems if sub.rest_s is not None), default=None)
        resting = "no joint was moving" + (SETTLED if (rest or 0.0) > SETTLED_S else "")
        still = nothing if not result.reached else late if result.latency_s > LATE_S else resting
        what = f"{', '.join(result.moving)} decelerating" if result.moving else f"{still}; the order arrived"
        line.append(f"{what} after {result.latency_s * 1e3:.2f} ms; ")
        if result.confirmed and rest is not None:
            line.append(f"rest confirmed after {rest * 1e3:.0f} ms", style="bold green")
        else:
            line.append(f"REST NOT CONFIRMED: {result.message}", style="bold white on red")
    out.print(line)
    if "halt" not in result.sent_to:
        out.print(
            Text("the broker did not get this order; subsystems pass it on, and start nothing until the broker has it")
        )

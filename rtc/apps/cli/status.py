"""rtc status: what runs in a cluster, as its broker reports it or, if that does not answer, its supervisor."""

from __future__ import annotations

import math
import time
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.live import Live
from rich.text import Text

from rtc.apps.cli.hosts import show_hosts
from rtc.apps.cli.output import NO_CLUSTER, AsJson, RunDir, With, cli_error, console, duration_s, emit_json, table
from rtc.client.client import Client
from rtc.model.robot import collision_checks
from rtc.protocol.messages import (
    REHEARSER,
    CommandRow,
    ProcessRow,
    ResourceRow,
    Status,
    SubsystemRow,
    WorkerKind,
)
from rtc.protocol.outcomes import NoCluster, TimedOut
from rtc.protocol.primitive_id import command_of
from rtc.protocol.versions import BOXES
from rtc.runtime import process_table
from rtc.runtime.run_dir import supervised
from rtc.runtime.settings import default_run_dir
from rtc.wording.measured import duration, seconds
from rtc.wording.sentences import quoted

SILENT = (
    "the broker does not answer; one that hangs or has died is replaced within seconds: ask again "
    "(its log is logs/broker.log in the run directory; rtc halt works meanwhile)"
)
PLANNERS = (WorkerKind.ELABORATOR, WorkerKind.BINDER)  # workers that check collisions
SUPERVISOR_SILENT_S = 3.0  # maximum age of the process table, which it sends every second
SUPERVISED = ("run_dir", "cluster", "uptime_s", "processes")  # what is known without the broker
SAME_AGE_S = 1.0  # maximum age difference of a cluster and a broker that was not restarted


def status(
    watch: Annotated[bool, typer.Option("--watch", help="Repeat until Ctrl-C.")] = False,
    every: Annotated[str, typer.Option(help="With --watch: the period, such as 1s or 500ms.")] = "1s",
    for_: Annotated[str, typer.Option("--for", help="With --watch: how long.", show_default="for ever")] = "",
    run_dir: RunDir = None,
    key: With = None,
    json: AsJson = False,
) -> None:
    """Show what runs: processes and their cube addresses, queues, resources and owners, commands, programs, counters.

    Exit status 4 when the broker does not answer; then it shows the supervisor's process table.

    Example:  rtc status
    Example:  rtc status --watch
    """
    every_s, for_s = duration_s(every, "--every"), duration_s(for_, "--for") if for_ else math.inf
    if watch and not json:
        with suppress(KeyboardInterrupt):
            _watch(run_dir, key, every_s, for_s)
        return
    report, silent = _status(run_dir, key)
    if silent:
        if not json:
            show_status(report, silent)
        raise cli_error(SILENT, NO_CLUSTER, **{name: getattr(report, name) for name in SUPERVISED}) from None
    if json:
        emit_json(report)
    else:
        show_status(report)


def _status(run_dir: Path | None, key: Path | None) -> tuple[Status, bool]:
    """The broker's status and False; if it does not answer, the supervisor's table and True. Raises NoCluster."""
    try:
        with Client(run_dir, key=key) as rtc:
            report = rtc.status()
    except (NoCluster, TimedOut):
        if key or not (known := as_supervised(run_dir or default_run_dir())):
            raise
        return known, True
    if not key and not report.processes and (known := as_supervised(run_dir or default_run_dir())):
        report = msgspec.structs.replace(report, processes=known.processes)  # a new broker has not received them yet
    return report, False


def _watch(run_dir: Path | None, key: Path | None, every_s: float, for_s: float) -> None:
    """Show the status repeatedly: on a terminal in place, otherwise one below the other. Raises NoCluster."""
    until_s = time.monotonic() + for_s
    # a console of its own: the live view must not treat the captured text below as printed above it
    with Live(console=Console(), auto_refresh=False) if console.is_terminal else nullcontext() as live:
        while True:
            report, silent = _status(run_dir, key)
            with console.capture() as shown:
                show_status(report, silent)
                if silent:
                    console.print(Text(SILENT, style="bold yellow"))
            if live is not None:
                live.update(Text.from_ansi(shown.get()), refresh=True)
            else:
                console.print(Text(time.strftime("%H:%M:%S")))
                console.print(Text.from_ansi(shown.get()))
            if (left_s := until_s - time.monotonic()) <= 0:
                return
            time.sleep(min(every_s, left_s))


def as_supervised(run_dir: Path) -> Status | None:
    """The supervisor's process table as a status, of which only SUPERVISED is known; None if no supervisor runs."""
    found = process_table.Table.load(run_dir)
    if found is None or not supervised(run_dir):
        return None
    up_s = time.time() - found.started_at
    return Status(run_dir=str(run_dir), cluster=found.cluster, uptime_s=up_s, processes=found.processes)


def show_status(report: Status, silent: bool = False) -> None:
    """Print a status; `silent`: only what is known without the broker."""
    where = f"cluster {report.cluster} in {report.run_dir}, up {seconds(report.uptime_s)}"
    restarted = not silent and report.uptime_s - report.broker_uptime_s > SAME_AGE_S
    since = f" (its broker {seconds(report.broker_uptime_s)}, after a restart)" if restarted else ""
    console.print(Text(where + since, style="bold"))
    for why in report.rolled_back.values():
        console.print(Text("program taken back: ", style="bold red") + Text(why))
    if report.supervisor_silent_s > SUPERVISOR_SILENT_S:
        words = (
            f"silent for {seconds(report.supervisor_silent_s)}: a process that dies is not started again, "
            "and the table below is as old"
        )
        console.print(Text("supervisor: ", style="bold red") + Text(words))
    for peer in report.refused:
        console.print(Text("refused: ", style="bold red") + Text(f"{peer.message} ({age(peer.ago_s)} ago)"))
    for row in report.processes:
        for note in row.notes:
            console.print(Text(f"{row.name}: ", style="bold red") + Text(note))
    _workers_and_processes(report)
    if not silent:
        _show_work(report)


def _show_work(report: Status) -> None:
    show_hosts(report)
    _commands(report.commands)
    _resources(report.resources)
    _subsystems(report.subsystems)
    console.print(Text("programs: ", style="bold") + Text(programs_in_words(report)))
    if checks := collision_checks_in_words(report):
        console.print(Text("collision checks: ", style="bold") + Text(checks))
    counters = {name: count for name, count in report.counters.items() if name != "halts"}  # they have their own line
    for name, counts in (("queues", report.queues), ("halts", {"called": report.halts.called}), ("counters", counters)):
        if words := ", ".join(f"{key} {count}" for key, count in counts.items() if count):
            console.print(Text(f"{name}: ", style="bold") + Text(words))


def collision_checks_in_words(report: Status) -> str:
    """What decides on collisions in the workers that plan; empty if there are none."""
    planners = [row for row in report.workers if row.kind in PLANNERS]
    slower = [row.name for row in planners if BOXES not in row.abilities]
    if not slower:
        return collision_checks(True) if planners else ""
    where = "" if len(slower) == len(planners) else f" ({', '.join(slower)})"
    return collision_checks(False) + where


def programs_in_words(report: Status) -> str:
    """The file loaded last for each kind of worker, and its age."""
    words = [f"{kind} {one.file} (loaded {age(one.age_s)} ago)" for kind, one in report.program_files.items()]
    rest = "all as they come with rtc" if not words else "the others: default programs"
    return ", ".join([*words, rest])


def age(value_s: float) -> str:
    """45 s, 12 min, 3 h 5 min."""
    return duration(max(1.0, round(value_s)))


def folded(rows: list[ProcessRow]) -> list[ProcessRow]:
    """The rows of the process table, with all ready fork servers in one row."""
    templates = [row for row in rows if row.name.endswith("template") and row.state == "ready"]
    if len(templates) < 2:
        return rows
    restarts = sum(row.restarts for row in templates)
    one = ProcessRow(name=f"{len(templates)} templates", state="ready", restarts=restarts)
    return [*(row for row in rows if row not in templates), one]


def _in_cube(process: str) -> bool:
    return "@" in process and not process.startswith(f"{REHEARSER}@")


def _workers_and_processes(report: Status) -> None:
    workers = {worker.name: worker for worker in report.workers}
    rows = folded(report.processes)
    here = {row.name for row in rows}
    elsewhere = "ready, elsewhere" if here else ""  # the supervisor knows only local processes
    others = [worker for worker in report.workers if worker.name not in here]
    rows = [*rows, *(ProcessRow(name=one.name, pid=one.pid, node=one.node, state=elsewhere) for one in others)]
    if not rows:
        return
    cube = [one.node for one in report.workers if _in_cube(one.name)]
    bits = max((address.bit_length() for address in cube), default=2) or 1
    out = table("process", "address", "pid>", "state", "restarts>", "done>", "waiting>", "busy with")
    for row in rows:
        worker = workers.get(row.name)
        node = worker.node if worker else row.node
        out.add_row(
            row.name,
            format(node, f"0{max(bits, 2)}b") if node is not None and _in_cube(row.name) else "",
            str(row.pid or ""),
            row.state,
            str(row.restarts) if row.name in here else "",
            *((str(worker.done), str(worker.queued), worker.busy_with) if worker else ("", "", "")),
        )
    console.print(out)


def _commands(commands: list[CommandRow]) -> None:
    if not commands:
        console.print("no command in progress")
        return
    out = table("command", "phase", "step", "age>", "holds", "sentence")
    for row in commands:
        held = ", ".join(row.resources)
        out.add_row(row.command, row.phase.value, row.step, seconds(row.age_s), held, Text(quoted(row.text)))
    console.print(out)


def _resources(resources: list[ResourceRow]) -> None:
    taken = [row for row in resources if row.owner or row.waiting]
    if not taken:
        return
    out = table("resource", "owner", "waiting")
    for row in taken:
        out.add_row(row.name, row.owner, ", ".join(row.waiting))
    console.print(out)


def _subsystems(subsystems: list[SubsystemRow]) -> None:
    for row in subsystems:
        executing = ", ".join(map(command_of, row.executing)) or "nothing"
        console.print(
            Text(f"{row.name}: ", style="bold")
            + Text(f"{row.state}, {', '.join(row.performers)}; executing {executing}")
        )
        if row.injected:
            console.print(Text(f"{row.name}: injected faults: ", style="bold red") + Text("; ".join(row.injected)))
        for words in row.strayed:
            console.print(Text(f"{row.name}: ", style="bold red") + Text(words))

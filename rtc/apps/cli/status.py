"""rtc status: what runs in a cluster, as its broker reports it or, if that does not answer, its supervisor."""

from __future__ import annotations

import math
import time
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
from rich.console import Console
from rich.live import Live
from rich.text import Text

from rtc.apps.cli.hosts import show_hosts
from rtc.apps.cli.measured import duration
from rtc.apps.cli.output import (
    NO_CLUSTER,
    AsJson,
    RunDir,
    With,
    cli_error,
    console,
    duration_s,
    emit_json,
    quoted,
    seconds,
    table,
)
from rtc.client.client import Client
from rtc.model.robot import collision_checks
from rtc.protocol.messages import REHEARSER, WorkerKind
from rtc.protocol.outcomes import NoCluster, TimedOut
from rtc.protocol.primitive_id import command_of
from rtc.protocol.versions import BOXES
from rtc.runtime import process_table
from rtc.runtime.run_dir import supervised
from rtc.runtime.settings import default_run_dir

SILENT = (
    "the broker does not answer; one that hangs or has died is replaced within seconds: ask again "
    "(its log is logs/broker.log in the run directory; rtc halt works meanwhile)"
)
PLANNERS = (WorkerKind.ELABORATOR, WorkerKind.BINDER)  # workers that check collisions
SUPERVISOR_SILENT_S = 3.0  # maximum age of the process table, which it sends every second
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
            show_status(report)
        raise cli_error(SILENT, NO_CLUSTER, **report) from None
    if json:
        emit_json(report)
    else:
        show_status(report)


def _status(run_dir: Path | None, key: Path | None) -> tuple[dict[str, Any], bool]:
    """The broker's status and False; if it does not answer, the supervisor's table and True. Raises NoCluster."""
    try:
        with Client(run_dir, key=key) as rtc:
            report = rtc.status()
    except (NoCluster, TimedOut):
        if key or not (known := as_supervised(run_dir or default_run_dir())):
            raise
        return known, True
    if not key and not report.get("processes"):  # a new broker has not received the table yet
        report |= {"processes": (as_supervised(run_dir or default_run_dir()) or {}).get("processes", [])}
    return report, False


def _watch(run_dir: Path | None, key: Path | None, every_s: float, for_s: float) -> None:
    """Show the status repeatedly: on a terminal in place, otherwise one below the other. Raises NoCluster."""
    until_s = time.monotonic() + for_s
    # a console of its own: the live view must not treat the captured text below as printed above it
    with Live(console=Console(), auto_refresh=False) if console.is_terminal else nullcontext() as live:
        while True:
            report, silent = _status(run_dir, key)
            with console.capture() as shown:
                show_status(report)
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


def as_supervised(run_dir: Path) -> dict[str, Any] | None:
    """The supervisor's process table in the form of a status; None if no supervisor runs."""
    found = process_table.Table.load(run_dir)
    if found is None or not supervised(run_dir):
        return None
    return {
        "run_dir": str(run_dir),
        "cluster": found.cluster,
        "uptime_s": time.time() - found.started_at,
        "processes": msgspec.to_builtins(found.processes),
    }


def show_status(report: dict[str, Any]) -> None:
    """Print a status (layout: docs/protocol.md); absent parts are left out."""
    up_s, where = report.get("uptime_s", 0.0), report.get("run_dir", "?")
    broker_s = report.get("broker_uptime_s", up_s)
    since = f" (its broker {seconds(broker_s)}, after a restart)" if up_s - broker_s > SAME_AGE_S else ""
    console.print(Text(f"cluster {report.get('cluster', '?')} in {where}, up {seconds(up_s)}{since}", style="bold"))
    for why in report.get("rolled_back", {}).values():
        console.print(Text("program taken back: ", style="bold red") + Text(why))
    if (silent_s := report.get("supervisor_silent_s", 0.0)) > SUPERVISOR_SILENT_S:
        words = (
            f"silent for {seconds(silent_s)}: a process that dies is not started again, and the table below is as old"
        )
        console.print(Text("supervisor: ", style="bold red") + Text(words))
    for row in report.get("refused", []):
        console.print(Text("refused: ", style="bold red") + Text(f"{row['message']} ({age(row['ago_s'])} ago)"))
    for row in report.get("processes") or []:
        for note in row.get("notes") or []:
            console.print(Text(f"{row['name']}: ", style="bold red") + Text(note))
    _workers_and_processes(report)
    show_hosts(report)
    if "commands" in report:
        _commands(report["commands"])
    _resources(report.get("resources", []))
    _subsystems(report.get("subsystems", []))
    if "programs" in report:
        console.print(Text("programs: ", style="bold") + Text(programs_in_words(report)))
    if checks := collision_checks_in_words(report):
        console.print(Text("collision checks: ", style="bold") + Text(checks))
    for name in ("queues", "halts", "counters"):
        figures = {key: value for key, value in report.get(name, {}).items() if value not in (0, None, "", [], {})}
        if name == "counters" and "halts" in report:
            figures.pop("halts", None)  # shown in the line above
        if figures:
            console.print(
                Text(f"{name}: ", style="bold") + Text(", ".join(f"{k} {_plain(v)}" for k, v in figures.items()))
            )


def collision_checks_in_words(report: dict[str, Any]) -> str:
    """What decides on collisions in the workers that plan; empty if there are none."""
    planners = [row for row in report.get("workers", []) if row.get("kind") in PLANNERS]
    slower = [row["name"] for row in planners if BOXES not in row.get("abilities", ())]
    if not slower:
        return collision_checks(True) if planners else ""
    where = "" if len(slower) == len(planners) else f" ({', '.join(slower)})"
    return collision_checks(False) + where


def programs_in_words(report: dict[str, Any]) -> str:
    """The file loaded last for each kind of worker, and its age."""
    files = report.get("program_files", {})
    words = [f"{kind} {one['file']} (loaded {age(one['age_s'])} ago)" for kind, one in files.items()]
    rest = "all as they come with rtc" if not words else "the others: default programs"
    return ", ".join([*words, rest])


def age(value_s: float) -> str:
    """45 s, 12 min, 3 h 5 min."""
    return duration(max(1.0, round(value_s)))


def folded(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows of the process table, with all ready fork servers in one row."""
    templates = [row for row in rows if row["name"].endswith("template") and row.get("state") == "ready"]
    if len(templates) < 2:
        return rows
    restarts = sum(row.get("restarts") or 0 for row in templates)
    one = {"name": f"{len(templates)} templates", "state": "ready", "restarts": restarts}
    return [*(row for row in rows if row not in templates), one]


def _in_cube(process: str) -> bool:
    return "@" in process and not process.startswith(f"{REHEARSER}@")


def _workers_and_processes(report: dict[str, Any]) -> None:
    workers = {worker["name"]: worker for worker in report.get("workers", [])}
    rows = folded(report.get("processes") or [])
    here = {row["name"] for row in rows}
    elsewhere = {"state": "ready, elsewhere"} if here else {}  # the supervisor knows only local processes
    rows = [*rows, *({**worker, **elsewhere} for name, worker in workers.items() if name not in here)]
    if not rows:
        return
    cube = [int(w["node"]) for w in workers.values() if _in_cube(w["name"])]
    bits = max((address.bit_length() for address in cube), default=2) or 1
    out = table("process", "address", "pid>", "state", "restarts>", "done>", "waiting>", "busy with")
    for row in rows:
        worker = workers.get(row["name"], {})
        node = worker.get("node", row.get("node"))
        out.add_row(
            row["name"],
            format(int(node), f"0{max(bits, 2)}b") if node is not None and _in_cube(row["name"]) else "",
            str(row.get("pid", "")),
            str(row.get("state", "")),
            str(row.get("restarts", "")),
            str(worker.get("done", "")),
            str(worker.get("queued", "")),
            str(worker.get("busy_with", "") or ""),
        )
    console.print(out)


def _commands(commands: list[dict[str, Any]]) -> None:
    if not commands:
        console.print("no command in progress")
        return
    out = table("command", "phase", "step", "age>", "holds", "sentence")
    for row in commands:
        out.add_row(
            row["command"],
            str(row.get("phase", "")),
            str(row.get("step", "")),
            seconds(row.get("age_s", 0.0)),
            ", ".join(row.get("resources", [])),
            Text(quoted(row.get("text", ""))),
        )
    console.print(out)


def _resources(resources: list[dict[str, Any]]) -> None:
    taken = [row for row in resources if row.get("owner") or row.get("waiting")]
    if not taken:
        return
    out = table("resource", "owner", "waiting")
    for row in taken:
        out.add_row(row["name"], str(row.get("owner", "")), ", ".join(row.get("waiting", [])))
    console.print(out)


def _subsystems(subsystems: list[dict[str, Any]]) -> None:
    for row in subsystems:
        executing = ", ".join(map(command_of, row.get("executing", []))) or "nothing"
        performers = ", ".join(row.get("performers", []))
        console.print(
            Text(f"{row['name']}: ", style="bold")
            + Text(f"{row.get('state', '')}, {performers}; executing {executing}")
        )
        if faults := row.get("injected"):
            console.print(Text(f"{row['name']}: injected faults: ", style="bold red") + Text("; ".join(faults)))
        for words in row.get("strayed", []):
            console.print(Text(f"{row['name']}: ", style="bold red") + Text(words))


def _plain(value: Any) -> str:
    if isinstance(value, dict):
        return "(" + ", ".join(f"{key} {inner}" for key, inner in value.items()) + ")"
    return str(value)

"""rtc up, down, status: the cluster as a whole. Starting and stopping is the supervisor's work (`python -m deploy`)."""

from __future__ import annotations

import math
import os
import signal
import sys
import time
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Annotated, Any, cast

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
from rtc.runtime.settings import MAX_DIM, MAX_REMOTE_WORKERS, MAX_WORKERS, MCMS, MIN_DIM, Mcm, Settings, default_run_dir

SILENT = (
    "the broker does not answer; one that hangs or has died is replaced within seconds: ask again "
    "(its log is logs/broker.log in the run directory; rtc halt works meanwhile)"
)
DEFAULT = Settings(run_dir="")  # the defaults of `rtc up`
PLANNERS = (WorkerKind.ELABORATOR, WorkerKind.BINDER)  # workers that check collisions
SUPERVISOR_SILENT_S = 3.0  # maximum age of the process table, which it sends every second
SAME_AGE_S = 1.0  # maximum age difference of a cluster and a broker that was not restarted


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

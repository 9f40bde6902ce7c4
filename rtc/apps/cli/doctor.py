"""rtc doctor: what of machine, installation and cluster would disturb the work, with what would mend it."""

from __future__ import annotations

import os
import platform
import pwd
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path

import msgspec
import typer
from rich.text import Text

from rtc import __version__
from rtc.apps.cli.log import from_cluster
from rtc.apps.cli.output import AsJson, RunDir, console, emit_json
from rtc.client.client import Client
from rtc.client.past_runs import PREVIOUS, runs
from rtc.model.robot import collision_checks, compiled
from rtc.plugins import registry
from rtc.protocol import messages as m
from rtc.protocol.outcomes import ClusterError, NoCluster, RtcError
from rtc.runtime.extras import EXTRAS, missing
from rtc.runtime.priority import may_be_real_time
from rtc.runtime.settings import default_run_dir, shell_command
from rtc.wording.measured import seconds

PACKAGE = "telerobot-rtc"
NEEDED_CORES = 2
MIN_MEMORY, MIN_DISK = 1 << 30, 2 << 30  # bytes: a cluster; the journals and logs of some long runs
SAMPLE_S = 1.0  # of the control ticks
SLOW_SHARE = 0.02  # of late ticks
SLOW_ITERATION_MS = 20.0  # of the broker, 99th percentile
SLOW_JOB_S = 5.0
SILENT_S = 3.0  # age of the process table, which the supervisor sends every second
COMMANDS = 20  # the newest, in which the slowest work is searched
GOOD = ("ready", "starting", "pending", "ending")  # states of a process


@dataclass(frozen=True)
class DoctorFinding:
    """One line. `mend`: what would mend it; empty if all is well."""

    about: str
    found: str
    mend: str = ""


def doctor(json: AsJson = False, run_dir: RunDir = None) -> None:
    """Check machine, installation and cluster: load, priorities, versions, disk, late ticks, what is slow.

    Each line is ok, or a warning with what would mend it. Works without a cluster too. Exit status 1 with a warning.

    Example:  rtc doctor
    Example:  rtc doctor --json
    """
    where = run_dir or default_run_dir()
    findings = [*machine(), *installation(), *directory(where), *cluster(where)]
    warnings = sum(bool(one.mend) for one in findings)
    if json:
        emit_json({"ok": not warnings, "findings": [{"ok": not one.mend, **asdict(one)} for one in findings]})
    else:
        _show(findings)
    raise typer.Exit(1 if warnings else 0)


def _show(findings: Iterable[DoctorFinding]) -> None:
    for one in findings:
        mark = Text("warning  ", style="bold yellow") if one.mend else Text("ok       ", style="green")
        console.print(mark + Text(f"{one.about}: {one.found}"))
        if one.mend:
            console.print(Text(f"         to mend it: {one.mend}"))


# --- the machine -------------------------------------------------------------------------------------


def machine() -> Iterator[DoctorFinding]:
    yield of_load(os.getloadavg()[0], len(os.sched_getaffinity(0)))
    yield of_memory(Path("/proc/meminfo").read_text())
    yield of_priority(may_be_real_time(1))


def of_load(load: float, cores: int) -> DoctorFinding:
    words = f"{load:.1f} processes want {cores} core{'s' * (cores != 1)}"
    if cores < NEEDED_CORES:
        return DoctorFinding(
            "load", words, f"give it {NEEDED_CORES} cores: with one, arms pause while motions are planned"
        )
    if load > cores:
        return DoctorFinding("load", words, "end other programs, or start with `rtc up --speed 0.5`: half of real time")
    return DoctorFinding("load", words)


def of_memory(meminfo: str) -> DoctorFinding:
    """`meminfo`: the text of /proc/meminfo."""
    found = re.search(r"^MemAvailable:\s+(\d+) kB", meminfo, re.MULTILINE)
    free = 1024 * int(found[1]) if found else 0
    return DoctorFinding(
        "memory", f"{_size(free)} available", "" if free >= MIN_MEMORY else "end programs that use much"
    )


def of_priority(permitted: bool) -> DoctorFinding:
    if permitted:
        return DoctorFinding("priority", "real-time priority is permitted to arms, broker and halts")
    user = pwd.getpwuid(os.getuid()).pw_name
    return DoctorFinding(
        "priority",
        "real-time priority is not permitted: with busy cores, ticks and halts are late",
        f"add the line `{user} - rtprio 5` to /etc/security/limits.conf and log in again; "
        "in a container: --cap-add SYS_NICE",
    )


# --- the installation --------------------------------------------------------------------------------


def installation() -> Iterator[DoctorFinding]:
    yield DoctorFinding("rtc", f"{__version__}, Python {platform.python_version()}, {platform.system()}")
    versions = {name: _version(name) for name in _requirements()}
    absent = [name for name, version in versions.items() if not version]
    words = ", ".join(f"{name} {version or 'missing'}" for name, version in versions.items())
    yield DoctorFinding("libraries", words, f"pip install {' '.join(absent)}" if absent else "")
    slower = "" if compiled() else "planning takes about twice as long; install a C++ compiler, then rtc again"
    yield DoctorFinding("collision checks", collision_checks(compiled()), slower)
    for extra in EXTRAS:
        yield DoctorFinding(f"extra for {extra}", missing(extra) or "installed")  # optional: no warning
    for group in registry.GROUPS:
        found, failed = _mechanisms() if group == registry.MECHANISMS else registry.loaded(group)
        if found:
            yield DoctorFinding(group, ", ".join(found))
        for name, why in failed.items():
            yield DoctorFinding(group, f"{name} cannot be loaded: {why}", "correct or uninstall its package")


def _mechanisms() -> tuple[list[str], dict[str, str]]:
    """Those that workers use, and why they do not use others: their rows are judged beside ours."""
    if not (names := registry.names(registry.MECHANISMS)):
        return [], {}
    command = [sys.executable, "-P", "-m", "workers.runtime.installed_mechanisms"]
    ran = subprocess.run(command, capture_output=True)
    try:
        known = msgspec.json.decode(ran.stdout)
        return known["found"], known["failed"]
    except (msgspec.DecodeError, KeyError):
        lines = ran.stderr.decode(errors="replace").strip().splitlines()
        why = lines[-1] if lines else f"a process that imports them ends with status {ran.returncode}"
        return [], dict.fromkeys(sorted(names), why)


def _requirements() -> list[str]:
    """The names of the libraries that every installation needs."""
    wanted = [line for line in metadata.requires(PACKAGE) or [] if "extra ==" not in line]
    return [re.match(r"[\w.-]+", line)[0] for line in wanted]  # type: ignore[index]


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


# --- the run directory -------------------------------------------------------------------------------


def directory(where: Path) -> Iterator[DoctorFinding]:
    there = next(path for path in (where, *where.absolute().parents) if path.is_dir())
    free = shutil.disk_usage(there).free
    mend = ""
    if not os.access(there, os.W_OK):
        mend = f"choose a directory that you may write: {shell_command('rtc up -d', Path('DIR'))}"
    elif free < MIN_DISK:
        mend = f"delete old runs ({where}/{PREVIOUS}*), or choose a directory on another disk by --run-dir"
    yield DoctorFinding("disk", f"{_size(free)} free for {where}; its runs use {_size(_used(where))}", mend)


def _used(where: Path) -> int:
    used = 0
    for folder, _, files in os.walk(where):
        for name in files:
            path = Path(folder, name)
            used += path.lstat().st_size if path.exists() else 0
    return used


# --- the cluster -------------------------------------------------------------------------------------


def cluster(where: Path) -> Iterator[DoctorFinding]:
    try:
        with Client(where) as client:
            status = client.status()
            yield from of_status(status)
            yield from of_ticks(client.telemetry(silence_s=SAMPLE_S))
            yield from of_work(from_cluster(client, COMMANDS))
    except NoCluster as none:
        yield DoctorFinding("cluster", str(none))  # it is no fault that none runs
        yield from _of_past(where)
    except ClusterError as error:
        mend = f"{shell_command('rtc down', where)}, then {shell_command('rtc up -d', where)}"
        yield DoctorFinding("cluster", str(error), f"ask again in some seconds; if it stays: {mend}")


def _of_past(where: Path) -> Iterator[DoctorFinding]:
    for past in runs(where):
        try:
            yield from of_work(past.last(COMMANDS), f" ({past.title})")
        except RtcError as error:
            yield DoctorFinding("journal", str(error), f"delete {past.journal}: it only holds a run that has ended")
        return


def of_status(status: m.Status) -> Iterator[DoctorFinding]:
    """Findings about the status of a cluster."""
    yield DoctorFinding("cluster", f"{status.cluster} runs for {status.uptime_s:.0f} s")
    if (silent_s := status.supervisor_silent_s) > SILENT_S:
        mend = "dead processes are not started again: `rtc down`, then `rtc up -d`"
        yield DoctorFinding("supervisor", f"silent for {seconds(silent_s)}", mend)
    rows = status.processes
    bad = [f"{row.name} {row.state}" for row in rows if row.state not in GOOD]
    died = [f"{row.name} {row.restarts} times" for row in rows if row.restarts]
    words = "; ".join(filter(None, [", ".join(bad), f"started again: {', '.join(died)}" if died else ""]))
    mend = f"the cause is in {status.run_dir}/logs/NAME.log"
    yield DoctorFinding("processes", words or f"all {len(rows)} run", mend if words else "")
    for subsystem in status.subsystems:
        if subsystem.state != "connected":
            yield DoctorFinding(subsystem.name, subsystem.state, f"wait until `rtc status` shows it connected; {mend}")
        if subsystem.injected:
            yield DoctorFinding(subsystem.name, f"injected faults: {'; '.join(subsystem.injected)}", "rtc inject undo")
    for resource in status.resources:
        if resource.quarantine:
            mend = "`rtc halt` confirms rest, once its subsystem answers"
            yield DoctorFinding(resource.name, f"closed: {resource.owner}", mend)
    yield of_broker(status.decision_ms)
    waiting = {kind: count for kind, count in status.queues.items() if count}
    words = ", ".join(f"{count} for {kind}" for kind, count in waiting.items()) or "no job waits"
    yield DoctorFinding("queues", words)


def of_broker(decision_ms: dict[str, float]) -> DoctorFinding:
    p99 = decision_ms.get("p99", 0.0)
    mend = "the machine is too busy, or its disk too slow: see load and disk above" if p99 > SLOW_ITERATION_MS else ""
    return DoctorFinding("broker", f"99 of 100 iterations take at most {p99:.1f} ms", mend)


def of_ticks(samples: Iterator[m.Telemetry]) -> Iterator[DoctorFinding]:
    """Findings about the control ticks during SAMPLE_S, and since the start of each MCM."""
    first = next(samples, None)
    if first is None:
        yield DoctorFinding("ticks", "no telemetry", "no subsystem of arms runs: see `rtc status` and its log in logs/")
        return
    last = next((one for one in samples if one.at_s - first.at_s >= SAMPLE_S), first)
    ticks, late = last.ticks - first.ticks, last.late_ticks - first.late_ticks
    words = f"{late} of {ticks} control ticks were late in {last.at_s - first.at_s:.1f} s; {last.late_ticks} of "
    words += f"{last.ticks} since the start"
    mend = "the machine is too busy: see load and priority above; `rtc up --speed 0.5` asks half of it"
    yield DoctorFinding("ticks", words, mend if late > SLOW_SHARE * max(1, ticks) else "")


def of_work(records: Iterable[m.CommandRecord], when: str = "") -> Iterator[DoctorFinding]:
    """The slowest job of a worker in these commands."""
    jobs = [(note, record) for record in records for note in record.notes if "@" in note.node]
    if not jobs:
        return
    note, record = max(jobs, key=lambda pair: pair[0].took_s)
    words = f"the slowest job of the last commands took {seconds(note.took_s)}: {note.node} for {record.command}{when}"
    mend = f"`rtc trace {record.command}` shows its steps; a free machine or a nearer goal takes less"
    yield DoctorFinding("jobs", words, mend if note.took_s > SLOW_JOB_S else "")


def _size(count: int) -> str:
    return f"{count / 2**30:.1f} GB" if count >= 2**30 else f"{count / 2**20:.0f} MB"

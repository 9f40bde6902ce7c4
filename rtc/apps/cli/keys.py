"""rtc keys: keys for access from other machines. Used on the cluster's machine; the cluster need not run."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
from rich.text import Text

from rtc.apps.cli.hosts import connections_of
from rtc.apps.cli.output import AsJson, RunDir, cli_error, console, emit_json, table
from rtc.client.client import Client
from rtc.protocol.messages import Status
from rtc.protocol.outcomes import ClusterError
from rtc.protocol.roles import Role
from rtc.runtime.keys import KeyRing, KnownKey, is_everywhere
from rtc.runtime.settings import Settings, default_run_dir, prepare_run_dir
from rtc.wording.measured import duration

ROLES = ", ".join(Role)

app = typer.Typer(
    help="Keys for other machines: make, list, revoke. See: rtc docs security.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="Name of the key, for example of its holder.")],
    role: Annotated[str, typer.Option(help=f"One of: {ROLES}.")],
    out: Annotated[Path | None, typer.Option(help="The file to write.", show_default="NAME.key")] = None,
    at: Annotated[
        str, typer.Option("--at", help="tcp://HOST:PORT as the other machine sees it.", show_default="as in rtc up")
    ] = "",
    count: Annotated[
        int, typer.Option(min=0, help="Workers that will use this key; rtc status compares.", show_default="not stated")
    ] = 0,
    run_dir: RunDir = None,
    json: AsJson = False,
) -> None:
    """Make a key: one file with all that the other machine needs. Keep it as secret as a password.

    It is valid at once, also for a running cluster.

    Example:  rtc keys new alice --role operator
    Example:  rtc keys new w1 --role worker --count 8 --at tcp://lab:5555
    """
    if role not in list(Role):
        raise cli_error(f"{role} is not a role; the roles are {ROLES}", 2)
    where = prepare_run_dir(run_dir or default_run_dir())
    file = out or Path(f"{name}.key")
    key = KeyRing(where).new(name, Role(role), at or _address(where), file, count)
    if json:
        emit_json({"name": key.name, "role": key.role, "address": key.address, "file": str(file)})
        return
    console.print(Text(f"{file} gives its holder access to {key.address} as {key.role}; keep it secret"))
    use = f"rtc status --with {file}"
    if key.role is Role.WORKER:
        use = f"python -m rtc workers --kind binder --with {file}"
    if key.role is not Role.SUBSYSTEM:
        console.print(Text(f"there: {use}", style="dim"))


@app.command("list")
def list_keys(run_dir: RunDir = None, json: AsJson = False) -> None:
    """List the keys: known ones, who is connected with them, and the latest revoked ones.

    Example:  rtc keys list
    """
    where = run_dir or default_run_dir()
    ring = KeyRing(where)
    known, revoked, report = ring.known(), ring.revoked(), _status(where)
    if json:
        emit_json({"keys": [_as_json(key, report) for key in known], "revoked": revoked})
        return
    keys = [*known, *revoked]
    if not keys:
        console.print("no keys are known: there is no access from other machines")
        return
    out = table("name", "role", "asked>", "connected", "last message", "made", "revoked", "public half")
    for key in keys:
        now, age_s, hosts = connections_of(report or Status(), "" if key.revoked_at else key.name)
        out.add_row(
            key.name,
            key.role,
            str(key.count or ""),
            f"{now} from {', '.join(hosts)}" if now else "",
            "" if age_s is None else f"{duration(age_s)} ago",
            _date(key.made_at),
            _date(key.revoked_at),
            Text(key.public),
        )
    console.print(out)
    if report is None:
        console.print(Text("no cluster answers here: connections are not known", style="dim"))


def _as_json(key: KnownKey, report: Status | None) -> dict[str, Any]:
    now, age_s, hosts = connections_of(report or Status(), key.name)
    found = msgspec.to_builtins(key)
    return found if report is None else {**found, "connections": now, "hosts": hosts, "last_message_ago_s": age_s}


def _date(at: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M", time.localtime(at)) if at else ""


def _status(run_dir: Path) -> Status | None:
    """The status of the cluster in this directory; None if it does not answer."""
    try:
        with Client(run_dir) as rtc:
            return rtc.status()
    except ClusterError:
        return None


@app.command()
def revoke(name: Annotated[str, typer.Argument(help="Name of the key.")], run_dir: RunDir = None) -> None:
    """Revoke a key. Its connections close within a second; commands in progress continue (halt them if needed).

    Example:  rtc keys revoke alice
    """
    key = KeyRing(run_dir or default_run_dir()).revoke(name)
    console.print(Text(f"{key.name} ({key.role}) is revoked"))


def _address(run_dir: Path) -> str:
    """The address of the cluster that is or was in this directory."""
    try:
        listen = Settings.load(run_dir).listen
    except FileNotFoundError:
        listen = ""
    if not listen:
        raise cli_error(
            "the address of the cluster is not known: give --at tcp://HOST:PORT, or first: rtc up --listen …", 2
        )
    if is_everywhere(listen):
        raise cli_error(f"the cluster listens at all addresses ({listen}); give the one that others use with --at", 2)
    return listen

"""The table of hosts in `rtc status`, and the connections of keys for `rtc keys list`."""

from __future__ import annotations

from collections.abc import Iterable

from rich.text import Text

from rtc.apps.cli.output import console, table
from rtc.protocol.messages import HostRow, MoreWorkersRow, Status
from rtc.wording.measured import duration, seconds

GATEWAY_SILENT_S = 3.0  # maximum age of the gateway's report, which it sends twice a second
LOST_SHOWN = 3  # maximum number of lost workers by name


def show_hosts(report: Status) -> None:
    """Print the hosts of workers and of refused peers; nothing for a cluster on one machine."""
    silent_s = report.gateway_silent_s
    if silent_s > GATEWAY_SILENT_S:
        words = f"it has not reported for {seconds(silent_s)}: hosts and refusals below are as old"
        console.print(Text("gateway: ", style="bold red") + Text(words))
    for request in report.asked_for:
        console.print(Text("more workers: ", style="bold") + Text(request_in_words(request)))
    rows = [row for row in report.hosts if _matters(row)]
    if len(rows) < 2:  # this machine alone
        return
    out = table("host", "key", "role", "asked>", "joined>", "refused>", "round trip>", "last message>", "link")
    first = {row.key: row for row in reversed(rows)}  # it shows what concerns the key on all hosts
    for row in rows:
        of_key = row is first[row.key]
        out.add_row(
            row.host,
            Text(row.key or ("" if row.role else "unknown key")),
            row.role,
            str(row.asked or "") if of_key else "",
            Text(str(row.joined) if row.role == "worker" else "", style="bold yellow" if row.missing else ""),
            str(row.refused or ""),
            round_trip(row),
            "" if row.last_message_ago_s is None else f"{duration(row.last_message_ago_s)} ago",
            Text("; ".join(_notes(row, of_key))),
        )
    console.print(out)


def _matters(row: HostRow) -> bool:
    return row.role == "worker" or row.refused > 0


def round_trip(row: HostRow) -> str:
    """The round-trip time of a row and its age; empty if it was not measured."""
    if row.round_trip_ms is None:
        return ""
    return f"{row.round_trip_ms:.2g} ms ({duration(row.round_trip_ago_s or 0.0)} ago)"


def _notes(row: HostRow, of_key: bool) -> Iterable[str]:
    yield row.state
    if row.missing and of_key:
        yield f"{row.missing} of {row.asked} missing"
    if lost := row.lost:
        latest = sorted(lost, key=lambda name: lost[name])
        more = f" and {len(latest) - LOST_SHOWN} more" if len(latest) > LOST_SHOWN else ""
        yield f"lost {', '.join(latest[:LOST_SHOWN])}{more} {duration(lost[latest[0]])} ago"
    if row.refused:
        yield f"refused {duration(row.refused_ago_s or 0.0)} ago: {row.refusal}"
    if row.late_results:
        yield f"{row.late_results} late results refused"


def request_in_words(request: MoreWorkersRow) -> str:
    """asked for 4 binders 12 s ago, 2 joined; the command ended with status 1: no such partition"""
    what = f"{request.asked} {request.kind}{'s' if request.asked != 1 else ''}"
    words = f"asked for {what} {duration(request.ago_s)} ago, {request.joined} joined"
    output = f": {request.output}" if request.output else ""
    if request.running:
        return f"{words}; the command is running"
    return f"{words}; the command {request.failed}{output}" if request.failed else words + output


def connections_of(report: Status, key: str) -> tuple[int, float | None, list[str]]:
    """(connections now, age in seconds of the latest message or None, hosts connected) of a key."""
    rows = [row for row in report.hosts if key and row.key == key]
    ages = [row.last_message_ago_s for row in rows if row.last_message_ago_s is not None]
    hosts = [row.host for row in rows if row.connections]
    return sum(row.connections for row in rows), min(ages, default=None), hosts

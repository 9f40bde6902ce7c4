"""The state of a cluster while the shell waits for a line: a thread asks for it, the toolbar and completion read it.

It also reports the ends of commands sent with `&`. It has a client of its own, because a client belongs to one thread,
and asks instead of receiving events, so that nothing is missed while a broker restarts.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from rtc.client.client import Client
from rtc.model.cells import taught
from rtc.protocol.messages import CommandRecord, CommandRow, Status
from rtc.protocol.outcomes import NoCluster, RtcError

ASK_S = 0.25  # pause between two questions
COMMANDS_SHOWN = 3

Words = list[tuple[str, str]]  # of the toolbar: style, text


class Live(NamedTuple):
    """The latest state. `trouble`: why it is older than usual; empty if it is not."""

    status: Status | None = None
    facts: Mapping[str, Any] = {}  # key -> value
    trouble: str = ""

    @property
    def arms(self) -> list[str]:
        return [key.removesuffix(".holding") for key in self.facts if key.endswith(".holding")]

    @property
    def commands(self) -> list[str]:
        """Numbers of the commands in progress."""
        return [row.command for row in self.status.commands] if self.status else []

    @property
    def places(self) -> list[str]:
        """The taught places."""
        return list(taught.postures(self.facts.items()))


class LiveState:
    """Context manager. `now`: the latest state; any thread may read it. `watched`: commands in progress whose end will
    be reported, by a call of `report` in the thread."""

    def __init__(
        self, run_dir: Path | None, key: Path | None, report: Callable[[CommandRecord], None] = lambda record: None
    ) -> None:
        self._run_dir, self._key, self._report = run_dir, key, report
        self.now = Live()
        self.watched: list[str] = []
        self._left = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> LiveState:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Report once more what has ended."""
        self._left.set()
        self._thread.join()

    def _serve(self) -> None:
        while not self._left.is_set():
            try:
                with Client(self._run_dir, key=self._key) as rtc:
                    self._follow(rtc)
            except RtcError as error:
                if isinstance(error, NoCluster):
                    self.watched.clear()
                self.now = self.now._replace(trouble=str(error))
                self._left.wait(ASK_S)

    def _follow(self, rtc: Client) -> None:
        """Ask until the shell is left. Raises RtcError if the cluster does not answer."""
        facts: dict[str, Any] = {}
        version = 0
        while not self._left.is_set():
            view = rtc.world.view(since=version)
            version = view.version
            facts = facts | {fact.key: fact.value for fact in view.facts}
            self.now = Live(rtc.status(), facts)
            self._report_ended(rtc)
            self._left.wait(ASK_S)
        if self.watched:
            self.now = Live(rtc.status(), facts)
            self._report_ended(rtc)

    def _report_ended(self, rtc: Client) -> None:
        for command in [command for command in self.watched if command not in self.now.commands]:
            record = rtc.trace(command)
            if record.outcome is not None:  # else there are more live commands than a status shows, or it is newer
                self.watched.remove(command)
                self._report(record)


def in_words(live: Live) -> Words:
    """The toolbar: the arms and what they hold, commands in progress, trouble."""
    if (status := live.status) is None:
        return [("bold", live.trouble or "connecting")]
    parts: list[Words] = [_arms(live, status), _commands(status.commands)]
    parts += [[("bold", words)] for words in [*_troubles(status), *filter(None, [live.trouble])]]
    if halts := status.halts.called:
        parts.append([("", f"{halts} halt{'s' if halts > 1 else ''} so far")])
    return [word for n, part in enumerate(parts) for word in ([("", "  |  ")] if n else []) + part]


def _arms(live: Live, status: Status) -> Words:
    owners = {row.name: row.owner for row in status.resources}
    words: Words = []
    for arm in live.arms:
        held, owner = live.facts[f"{arm}.holding"], owners.get(arm, "")
        state = (f" holds {held}" if held else "") + (f" in use by {owner}" if owner else "")
        words += [("bold", ("   " if words else "") + arm), ("", state or " free")]
    return words


def _commands(rows: list[CommandRow]) -> Words:
    if not rows:
        return [("", "no command in progress")]
    shown = [f"{row.command} {row.phase} {row.step}".rstrip() for row in rows[:COMMANDS_SHOWN]]
    more = len(rows) - len(shown)
    return [("", ", ".join(shown) + (f", and {more} more" if more else ""))]


def _troubles(status: Status) -> list[str]:
    found = []
    for row in status.subsystems:
        if row.state != "connected":
            found.append(f"{row.name} is {row.state}")
        found += [f"{row.name}: injected {fault}" for fault in row.injected]
        found += row.strayed
    return found

"""The latest reports of EVERY and WHEN, kept for `rtc trace` and `rtc log`.

Bounded in commands and in reports of each; the oldest give way and are counted. They are neither journalled nor part of
the state: a broker that restarts has none.
"""

from __future__ import annotations

from collections import OrderedDict, deque

import msgspec

from rtc.protocol.messages import CommandRecord, ProgressNote

COMMANDS, REPORTS = 200, 50  # maximum number of commands with reports, and of reports of each


class RecentReports:
    def __init__(self) -> None:
        self._kept: OrderedDict[str, deque[ProgressNote]] = OrderedDict()
        self._received: dict[str, int] = {}

    def keep(self, note: ProgressNote) -> None:
        if note.command not in self._kept:
            self._kept[note.command], self._received[note.command] = deque(maxlen=REPORTS), 0
            if len(self._kept) > COMMANDS:
                oldest, _ = self._kept.popitem(last=False)
                del self._received[oldest]
        self._kept[note.command].append(note)
        self._received[note.command] += 1

    def add_to(self, record: CommandRecord) -> CommandRecord:
        """The record with the reports of its command."""
        kept = self._kept.get(record.command)
        if not kept:
            return record
        older = self._received[record.command] - len(kept)
        return msgspec.structs.replace(record, reports=list(kept), reports_older=older)

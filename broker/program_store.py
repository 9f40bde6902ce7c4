"""The bodies of programs and of the cell, by digest: workers fetch from here what they have not cached."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from broker.journal import Journal
from rtc.digest import digest
from rtc.messages import ProgramText, WorkerKind
from rtc.outcomes import Refusal, RefusalReason
from rtc.program_check import Asked, Checked


class Loaded(NamedTuple):
    digest: str  # of the whole program
    changes: list[str]  # in words


class ProgramStore:
    """`in_use`: kind -> digest, as the Decision Unit has it."""

    def __init__(self, journal: Journal, in_use: Mapping[str, str] | None = None) -> None:
        self._journal = journal
        self._in_use = {} if in_use is None else in_use  # it may be filled later
        self._bodies = journal.programs()

    def keep(self, body: bytes) -> str:
        """Keep a body, through restarts too; returns its digest."""
        name = digest(body)
        if name not in self._bodies:
            self._bodies[name] = body
            self._journal.keep_program(name, body)
        return name

    def body(self, digest: str) -> bytes | None:
        return self._bodies.get(digest)

    def asked(self, text: ProgramText) -> Asked:
        """What must be checked to put a file into the program of a kind (LOAD), or to take all back."""
        others = {kind: self._bodies[self._in_use[kind]] for kind in WorkerKind if kind in self._in_use}
        return Asked(
            kind=text.kind,
            name=text.name,
            body=text.body,
            reset=text.reset,
            program=self._bodies[self._in_use[text.kind]],
            others=others,
        )

    def take(self, text: ProgramText, checked: Checked) -> Loaded | Refusal:
        """Keep a program that checks; or why it does not."""
        if checked.error:
            return Refusal(reason=RefusalReason.PROGRAM, message=checked.error, where=text.name)
        return Loaded(self.keep(checked.merged), checked.changes)

"""Program store: bodies of programs and of the cell by digest. Workers fetch from it what they have not cached."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from broker.persistence.journal import Journal
from rtc.programs.sandbox import CheckRequest, CheckResult
from rtc.protocol.digest import digest
from rtc.protocol.messages import ProgramText, WorkerKind
from rtc.protocol.outcomes import Refusal, RefusalReason


class StoredProgram(NamedTuple):
    """A checked and stored program."""

    digest: str  # of the merged program
    changes: list[str]  # differences to the previous program, in words


class ProgramStore:
    """Stores bodies in the journal. `in_use`: kind -> digest, shared with the state of the Decision Unit."""

    def __init__(self, journal: Journal, in_use: Mapping[str, str] | None = None) -> None:
        self._journal = journal
        self._in_use = {} if in_use is None else in_use  # it may be filled later
        self._bodies = journal.programs()

    def keep(self, body: bytes) -> str:
        """Store a body in the journal; returns its digest."""
        name = digest(body)
        if name not in self._bodies:
            self._bodies[name] = body
            self._journal.keep_program(name, body)
        return name

    def body(self, digest: str) -> bytes | None:
        return self._bodies.get(digest)

    def asked(self, text: ProgramText) -> CheckRequest:
        """The input of the check that merges a file into a program (LOAD) or resets the program."""
        others = {kind: self._bodies[self._in_use[kind]] for kind in WorkerKind if kind in self._in_use}
        return CheckRequest(
            kind=text.kind,
            name=text.name,
            body=text.body if not text.reset else self._bodies[text.to] if text.to else b"",
            reset=text.reset,
            program=self._bodies[self._in_use[text.kind]],
            others=others,
        )

    def take(self, text: ProgramText, checked: CheckResult) -> StoredProgram | Refusal:
        """Store a program that passed its check; otherwise return the refusal."""
        if checked.error:
            return Refusal(reason=RefusalReason.PROGRAM, message=checked.error, where=text.name)
        return StoredProgram(self.keep(checked.merged), checked.changes)

"""Queue of programs to load: each is checked in a process of its own before it is used.

Checks run one at a time, because each file is merged into the result of the previous one. The broker does not block.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol

from broker.decisions.effects import LoadPart
from broker.persistence.program_store import ProgramStore, StoredProgram
from rtc.programs.sandbox import CheckRequest, CheckResult, check
from rtc.protocol.advice import by_person
from rtc.protocol.messages import ProgramText
from rtc.protocol.outcomes import Refusal, RefusalReason

MAX_WAITING = 8  # maximum number of queued loads

Asker = bytes | LoadPart  # a client, or the job of a sentence


class Check(Protocol):
    """A running check."""

    def result(self, now: float) -> CheckResult | None:
        """The result; None while the check runs."""


class InProcessCheck:
    """A check in the calling process, for tests and simulations."""

    def __init__(self, asked: CheckRequest) -> None:
        self._checked = check(asked)

    def result(self, now: float) -> CheckResult | None:
        return self._checked


class FinishedLoad(NamedTuple):
    asker: Asker
    text: ProgramText
    loaded: StoredProgram | Refusal


class ProgramLoads:
    """`start` starts a check; it may raise OSError."""

    def __init__(self, store: ProgramStore, start: Callable[[CheckRequest], Check] = InProcessCheck) -> None:
        self._store, self._start = store, start
        self._waiting: deque[tuple[Asker, ProgramText]] = deque()
        self._running: Check | None = None  # check of the first one

    @property
    def busy(self) -> bool:
        return bool(self._waiting)

    def add(self, asker: Asker, text: ProgramText) -> Refusal | None:
        """Queue a load. A repeated request is ignored. Returns a refusal if the queue is full."""
        if any((asker, text.request) == (other, known.request) for other, known in self._waiting):
            return None
        if len(self._waiting) >= MAX_WAITING:
            words = f"{MAX_WAITING} programs are being checked"
            return Refusal(
                reason=RefusalReason.OVERLOAD, message=words, clears=by_person("load it again a few seconds later")
            )
        self._waiting.append((asker, text))
        return None

    def poll(self, now: float) -> Iterator[FinishedLoad]:
        """Yield finished loads. The caller must install each before it takes the next."""
        while self._waiting:
            asker, text = self._waiting[0]
            if self._running is None:
                try:
                    self._running = self._start(self._store.asked(text))
                except OSError as error:
                    self._waiting.popleft()
                    words = f"no process can be started to check it: {error}"
                    yield FinishedLoad(asker, text, Refusal(reason=RefusalReason.OVERLOAD, message=words))
                    continue
            if (checked := self._running.result(now)) is None:
                return
            self._running = None
            self._waiting.popleft()
            yield FinishedLoad(asker, text, self._store.take(text, checked))

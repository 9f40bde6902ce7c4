"""The open requests of a client, with their callbacks, and the outcomes and answers that have arrived."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

from rtc.protocol import messages as m
from rtc.protocol.outcomes import Outcome, OutcomeKind, Refusal, RequestDeclined

KEPT = 10_000  # maximum number of unfetched outcomes

OnProgress = Callable[[m.ProgressNote], None]
OnEnded = Callable[[m.CommandEnded], None]
Answer = TypeVar("Answer")


class Requests:
    """`take` handles one message of the broker; `fetch` returns an outcome once. A repeated message changes nothing."""

    def __init__(self) -> None:
        self.command_of: dict[str, str] = {}  # request -> C-n
        self.request_of: dict[str, str] = {}  # C-n -> request
        self.ended: dict[str, m.CommandEnded] = {}  # request -> outcome, until it is fetched
        self.queries: set[str] = set()  # requests that are queries, not sentences
        self.answers: dict[str, m.BrokerToClient] = {}  # request -> answer to a query
        self._on_progress: dict[str, OnProgress] = {}  # request -> callback for its notes
        self._on_accept: dict[str, Callable[[str], None]] = {}
        self._on_ended: dict[str, OnEnded] = {}  # request -> the receiver of its outcome
        self._fetched: dict[str, None] = {}  # latest fetched requests, to recognise a repeated outcome

    def watch(
        self,
        request: str,
        on_progress: OnProgress | None,
        on_accept: Callable[[str], None] | None,
        on_ended: OnEnded | None = None,
    ) -> None:
        """Call these for the notes of a sentence, with its number C-n when it is accepted, and with its outcome, which
        is then fetched."""
        if on_progress is not None:
            self._on_progress[request] = on_progress
        if on_accept is not None:
            self._on_accept[request] = on_accept
        if on_ended is not None:
            self._on_ended[request] = on_ended

    def take(self, message: m.BrokerToClient) -> None:
        match message:
            case m.Accepted(request=request, command=command):
                if request not in self.command_of:  # a second Accepted answers a repeated sentence
                    self.command_of[request] = command
                    self.request_of[command] = request
                    if on_accept := self._on_accept.pop(request, None):
                        on_accept(command)
            case m.ProgressNote(command=command):
                if on_progress := self._on_progress.get(self.request_of.get(command, "")):
                    on_progress(message)
            case m.CommandEnded(request=request):
                self._keep_outcome(request, message)
            case m.Declined(request=request, refusal=refusal) if request in self.queries:
                self.answers[request] = message
            case m.Declined(request=request, refusal=refusal):
                self._keep_outcome(request, _as_refused(request, refusal))
            case m.StatusReply() | m.TraceReply() | m.ProgramLoaded() | m.ProgramReply() | m.Debugged():
                if message.request in self.queries:
                    self.answers[message.request] = message

    def _keep_outcome(self, request: str, ended: m.CommandEnded) -> None:
        if request in self._fetched:
            return  # repeated, after a reconnect
        self.ended[request] = ended
        if on_ended := self._on_ended.pop(request, None):
            on_ended(self.fetch(request))
        while len(self.ended) > KEPT:
            self.fetch(next(iter(self.ended)))

    def fetch(self, request: str) -> m.CommandEnded:
        """Return an outcome and forget its command."""
        self._on_progress.pop(request, None)
        self._on_accept.pop(request, None)
        self.request_of.pop(self.command_of.pop(request, ""), None)
        self._fetched[request] = None
        while len(self._fetched) > KEPT:
            del self._fetched[next(iter(self._fetched))]
        return self.ended.pop(request)


def expect(message: object, kind: type[Answer]) -> Answer:
    """The message, which must be of this kind. Raises RequestDeclined for a refusal."""
    if isinstance(message, m.Declined):
        raise RequestDeclined(message.refusal)
    assert isinstance(message, kind), f"expected {kind.__name__}, got {message!r}"
    return message


def _as_refused(request: str, refusal: Refusal) -> m.CommandEnded:
    """The outcome of a sentence that did not become a command: a refusal, so that callers handle one type."""
    outcome = Outcome(kind=OutcomeKind.REFUSED, message=refusal.message, refusal=refusal)
    return m.CommandEnded(seq=0, at_s=time.monotonic(), command="", request=request, text="", outcome=outcome, took_s=0)

"""The handle of a submitted command: wait for it, see how far it is, pause it, halt it.

    from rtc import Client

    with Client() as client:
        lift = client.submit("LIFT MACS-NEW BY 10 CM WITH RIGHT-ARM")
        print(lift.progress)
        lift.raise_for_outcome()

A handle belongs to its client and to the client's thread; `halt` may be called from any thread.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from rtc.client.halt import HaltResult
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Outcome

OnProgress = Callable[[m.ProgressNote], None]
OnChange = Callable[[], None]  # called when a command has got its number, and when it has ended
TEXT_SHOWN = 60  # characters of the sentence in `repr`


class ItsClient(Protocol):
    """What a handle uses of its `Client`."""

    def receive(self) -> None: ...
    def receive_until(self, done: Callable[[], object], timeout_s: float | None, otherwise: str) -> None: ...
    def run(self, text: str, on_progress: None = None, timeout_s: float | None = None) -> m.CommandEnded: ...
    def halt(self, scope: str, timeout_s: float) -> HaltResult: ...


class CommandHandle:
    """One command of a client, from `Client.submit`. `number`: C-n; `str` of the handle is the number too."""

    def __init__(
        self, client: ItsClient, text: str, on_progress: OnProgress | None, on_change: OnChange | None = None
    ) -> None:
        self.text = text
        self.number = ""
        self._client = client
        self._on_progress = on_progress
        self._on_change = on_change
        self._progress: m.ProgressNote | None = None
        self._ended: m.CommandEnded | None = None

    def __str__(self) -> str:
        return self.number

    def __repr__(self) -> str:
        text = self.text if len(self.text) <= TEXT_SHOWN else f"{self.text[: TEXT_SHOWN - 3]}..."
        if self._ended is not None:
            state = self._ended.outcome.kind.value
        else:
            state = self._progress.phase.value if self._progress is not None else "accepted"
        return f"<CommandHandle {self.number} {state}: {text}>"

    @property
    def ended(self) -> m.CommandEnded | None:
        """Its end, with outcome and duration; None while it is in progress."""
        if self._ended is None:
            self._client.receive()
        return self._ended

    @property
    def outcome(self) -> Outcome | None:
        """How it ended; None while it is in progress."""
        return None if (ended := self.ended) is None else ended.outcome

    @property
    def progress(self) -> m.ProgressNote | None:
        """Its latest note: phase, step, expected duration; None before the first. Reports of EVERY and WHEN, which are
        not about its progress, go to `on_progress` only."""
        if self._ended is None:
            self._client.receive()
        return self._progress

    def wait(self, timeout_s: float | None = None) -> m.CommandEnded:
        """Its end, as often as called. Raises TimedOut if it does not end in time; it then continues."""
        if self._ended is None:
            self._client.receive_until(
                lambda: self._ended is not None, timeout_s, f"{self.number} has not ended; it continues"
            )
        assert self._ended is not None
        return self._ended

    def raise_for_outcome(self, timeout_s: float | None = None) -> m.CommandEnded:
        """Wait for its end. Raises NotSucceeded unless it succeeded, and TimedOut as `wait` does."""
        return self.wait(timeout_s).raise_for_outcome()

    def halt(self, timeout_s: float = 2.0) -> HaltResult:
        """Stop this command now, past all queues: see `Client.halt`."""
        return self._client.halt(self.number, timeout_s)

    def pause(self, timeout_s: float | None = None) -> None:
        """Stop on its path and wait there. Raises NotSucceeded, for example if it has ended, and TimedOut."""
        self._control("PAUSE", timeout_s)

    def resume(self, timeout_s: float | None = None) -> None:
        """Continue after `pause`. Raises as `pause` does."""
        self._control("RESUME", timeout_s)

    def abort(self, timeout_s: float | None = None) -> None:
        """End it; its end is ABORTED. Raises as `pause` does."""
        self._control("ABORT", timeout_s)

    def _control(self, verb: str, timeout_s: float | None) -> None:
        self._client.run(f"{verb} {self.number}", timeout_s=timeout_s).raise_for_outcome()

    # --- called by the client -------------------------------------------------------------------------

    @property
    def answered(self) -> bool:
        """It is accepted or declined."""
        return bool(self.number) or self._ended is not None

    @property
    def known_end(self) -> m.CommandEnded | None:
        """Its end as far as received; nothing is received here."""
        return self._ended

    def take_number(self, number: str) -> None:
        self.number = number
        if self._on_change is not None:
            self._on_change()

    def take_note(self, note: m.ProgressNote) -> None:
        if note.seq:
            self._progress = note
        if self._on_progress is not None:
            self._on_progress(note)

    def take_end(self, ended: m.CommandEnded) -> None:
        self._ended = ended
        if self._on_change is not None:
            self._on_change()

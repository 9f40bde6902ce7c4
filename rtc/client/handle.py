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

from rtc.client.core import OnProgress, SubmittedCommand
from rtc.client.halt import HaltResult
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Outcome

OnChange = Callable[[], None]  # called when a command has got its number, and when it has ended
TEXT_SHOWN = 60  # characters of the sentence in `repr`


class ItsClient(Protocol):
    """What a handle uses of its `Client`."""

    def receive(self) -> None: ...
    def receive_until(self, done: Callable[[], object], timeout_s: float | None, otherwise: str) -> None: ...
    def run(self, text: str, on_progress: None = None, timeout_s: float | None = None) -> m.CommandEnded: ...
    def halt(self, scope: str, timeout_s: float) -> HaltResult: ...


class CommandHandle(SubmittedCommand):
    """One command of a client, from `Client.submit`. `number`: C-n; `str` of the handle is the number too."""

    def __init__(
        self, client: ItsClient, text: str, on_progress: OnProgress | None, on_change: OnChange | None = None
    ) -> None:
        changed = None if on_change is None else lambda _: on_change()
        super().__init__(text, on_progress, changed, changed)
        self._client = client

    def __str__(self) -> str:
        return self.number

    def __repr__(self) -> str:
        text = self.text if len(self.text) <= TEXT_SHOWN else f"{self.text[: TEXT_SHOWN - 3]}..."
        if self.known_end is not None:
            state = self.known_end.outcome.kind.value
        else:
            state = self.latest_note.phase.value if self.latest_note is not None else "accepted"
        return f"<CommandHandle {self.number} {state}: {text}>"

    @property
    def ended(self) -> m.CommandEnded | None:
        """Its end, with outcome and duration; None while it is in progress."""
        if self.known_end is None:
            self._client.receive()
        return self.known_end

    @property
    def outcome(self) -> Outcome | None:
        """How it ended; None while it is in progress."""
        return None if (ended := self.ended) is None else ended.outcome

    @property
    def progress(self) -> m.ProgressNote | None:
        """Its latest note: phase, step, expected duration; None before the first. Reports of EVERY and WHEN, which are
        not about its progress, go to `on_progress` only."""
        if self.known_end is None:
            self._client.receive()
        return self.latest_note

    def wait(self, timeout_s: float | None = None) -> m.CommandEnded:
        """Its end, as often as called. Raises TimedOut if it does not end in time; it then continues."""
        if self.known_end is None:
            self._client.receive_until(
                lambda: self.known_end is not None, timeout_s, f"{self.number} has not ended; it continues"
            )
        assert self.known_end is not None
        return self.known_end

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

"""Commands sent with `&` in the shell: a thread reports how each of them ends.

It has a client of its own, because a client belongs to one thread. It queries the broker instead of receiving events,
so that nothing is missed while a broker restarts.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from rtc.client.client import Client
from rtc.protocol import messages as m
from rtc.protocol.outcomes import NoCluster, RtcError

ASK_S = 0.25


class Background:
    """`watch` a command; `report` is called in another thread with the record of each that has ended."""

    def __init__(self, run_dir: Path | None, key: Path | None, report: Callable[[m.CommandRecord], None]) -> None:
        self._run_dir, self._key, self._report = run_dir, key, report
        self._waiting: list[str] = []
        self._changed = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def watch(self, command: str) -> None:
        with self._changed:
            self._waiting.append(command)
            if not self._thread.is_alive() and not self._closed:
                self._thread = threading.Thread(target=self._serve, daemon=True)
                self._thread.start()
            self._changed.notify()

    def close(self) -> list[str]:
        """Report once more, then stop; returns the commands still in progress."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join()
        return self._waiting

    def _serve(self) -> None:
        try:
            with Client(self._run_dir, key=self._key) as rtc:
                while self._awaited():
                    self._ask(rtc)
                self._ask(rtc)
        except NoCluster:  # the shell detects that itself
            with self._changed:
                self._waiting.clear()

    def _awaited(self) -> bool:
        """Wait until a command is watched; False once closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._waiting)
            self._changed.wait_for(lambda: self._closed, ASK_S)
            return not self._closed

    def _ask(self, rtc: Client) -> None:
        """Raises NoCluster."""
        try:
            live = {row.command for row in rtc.status().commands}
            with self._changed:
                over = [command for command in self._waiting if command not in live]
            for command in over:
                record = rtc.trace(command)
                if record.outcome is None:
                    continue  # there are more live commands than a status shows
                with self._changed:
                    self._waiting.remove(command)
                self._report(record)
        except NoCluster:
            raise
        except RtcError:
            pass  # an unresponsive broker is replaced; ask again

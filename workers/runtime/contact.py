"""Contact of a remote worker with its broker: the age of the broker's last answer, and everything that depends on it.

A worker without an answer for `limit_s` ends by itself. The age is also shown to the engine that runs the worker: in a
health file (`workers.runtime.health` reads it) and to systemd (`sd_notify`). Must not know jobs or sockets of ZeroMQ.
"""

from __future__ import annotations

import logging
import socket
from pathlib import Path

from rtc.protocol.outcomes import ClusterError

LIMIT_S = 15.0  # default time limit; longer than a restart of the broker and than a short failure of the network
MAX_JOB_S = 15.0  # processor time; the broker's own limit of a job is not longer
SHOWN_S = 0.4  # minimum interval between two updates of the health file and of systemd


class Systemd:
    """The notification socket of systemd (`man sd_notify`). `address`: NOTIFY_SOCKET; "@" begins an abstract name."""

    def __init__(self, address: str) -> None:
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)

    def send(self, state: str) -> None:
        """Send `state`, lines of NAME=VALUE; it is dropped if systemd does not read."""
        try:
            self._socket.sendto(state.encode(), self._address)
        except OSError as error:
            logging.getLogger("systemd").warning("%s was not sent: %s", state.partition("\n")[0], error)

    def close(self) -> None:
        self._socket.close()


class BrokerContact:
    """Made when the worker starts (`now`, CLOCK_MONOTONIC in s). Raises ClusterError if `health` cannot be written."""

    def __init__(
        self, now: float, limit_s: float = LIMIT_S, health: Path | None = None, systemd: Systemd | None = None
    ) -> None:
        self.limit_s = limit_s
        self.worker = ""  # "binder@18"; empty until the broker has answered
        self._health, self._systemd = health, systemd
        self._last_s = now
        self._worked_s = 0.0  # processor time of the job in progress, when it was last shown
        self._shown_s = 0.0
        if health is not None:
            try:
                health.write_text("")  # written now, so that a wrong path is reported at the start
            except OSError as error:
                raise ClusterError(f"cannot write the health file {health}: {error.strerror}") from None

    def answered(self, worker: str, now: float) -> None:
        """The broker has answered this worker."""
        first, self.worker = not self.worker, worker
        self._last_s = now
        if first or now - self._shown_s > SHOWN_S:
            self._shown_s = now
            self._show(first, now)

    def working(self, worked_s: float, now: float) -> None:
        """A job is in progress and has used the processor for `worked_s`. On a busy machine that takes any time by the
        clock, so the engine sees that it works, until the job has used more than any job may."""
        if self.worker and self._worked_s < worked_s <= MAX_JOB_S:
            self._show(False, now)
        self._worked_s = worked_s

    def worked(self, now: float) -> None:
        """A job has ended. During a job no answer is read, so the time limit begins again."""
        self._last_s = max(self._last_s, now)

    def lost(self, now: float) -> bool:
        """True if the broker has not answered for `limit_s`."""
        return now - self._last_s > self.limit_s

    def close(self) -> None:
        """The worker ends: its health file is removed."""
        if self._health is not None:
            self._health.unlink(missing_ok=True)
        if self._systemd is not None:
            self._systemd.send("STOPPING=1")
            self._systemd.close()

    def _show(self, first: bool, now: float) -> None:
        if self._systemd is not None:
            self._systemd.send(f"READY=1\nSTATUS=joined as {self.worker}\nWATCHDOG=1" if first else "WATCHDOG=1")
        if self._health is not None:
            aside = self._health.with_name(f".{self._health.name}.new")
            try:
                aside.write_text(f"{self.worker} {now:.3f}\n")
                aside.replace(self._health)
            except OSError as error:  # the probe fails, and the engine decides
                logging.getLogger(self.worker).warning("cannot write the health file: %s", error)

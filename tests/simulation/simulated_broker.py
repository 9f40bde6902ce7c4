"""One broker process of the simulated cluster: the real loop and journal on simulated sockets.

It may be killed between two batches, before a batch is journalled, after that, and before any one of its messages.
"""

from __future__ import annotations

import logging
import sqlite3
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from broker.decisions.events import BrokerRestarted, Event, ProgramInstalled
from broker.persistence.journal import Journal
from broker.persistence.program_store import ProgramStore
from broker.persistence.replay import replay
from broker.router.core import Core
from broker.router.loop import Router
from rtc.protocol import messages as m
from rtc.runtime.settings import Settings
from tests.simulation import network

if TYPE_CHECKING:
    from tests.simulation.cluster import Cluster


SETTINGS = Settings(run_dir="/nowhere", run="simulated")
SILENT = logging.getLogger("simulated broker")
SILENT.disabled = True


class Crash(BaseException):
    """The broker's process is killed just here."""


class Broker:
    """One broker process: the real shell on simulated sockets."""

    def __init__(self, cluster: Cluster, db: sqlite3.Connection, pid: int) -> None:
        self.cluster, self.pid, self.name = cluster, pid, "broker"
        self.alive, self.stopped = True, False
        self.sends_left: int | None = None  # it dies before it sends one more
        self.dies_in_journal = ""  # "before" or "after" the next turn is written
        self.sockets: dict[str, network.Router] = {}
        journal = FragileJournal(db, self)
        state, _ = replay(journal)
        self.state = state
        me = SimpleNamespace(socket=self._socket, log=SILENT, stopping=False)
        self.router = Router(
            Core(me, SETTINGS, journal, state, ProgramStore(journal), cluster.handed, cluster.clock)  # type: ignore[arg-type]
        )
        now_s = cluster.clock.now_s
        if state.programs:
            self.router.enqueue(BrokerRestarted(at_s=now_s))
        else:
            for kind in m.WorkerKind:
                self.router.enqueue(ProgramInstalled(at_s=now_s, kind=kind, digest=kind.value))
        cluster.broker_begins(self, journal)
        self._wakes_at_s = 0.0

    def _socket(self, kind: int, endpoint: str, *, handover: bool = True, **_: Any) -> network.Router:
        name = endpoint.rpartition("/")[2].removesuffix(".sock")
        self.sockets[name] = network.Router(self.cluster.clock, self.wake, self.sending, handover)
        return self.sockets[name]

    def sending(self) -> None:
        if self.sends_left is not None:
            self.sends_left -= 1
            if self.sends_left < 0:
                raise Crash

    def wake(self) -> None:
        """Something has come: a turn soon."""
        self._turn_at(self.cluster.clock.now_s + 0.00005)

    def _turn_at(self, at_s: float) -> None:
        if self._wakes_at_s <= self.cluster.clock.now_s or at_s < self._wakes_at_s:
            self._wakes_at_s = at_s
            self.cluster.clock.at(at_s, self._turn, at_s)

    def _turn(self, planned_s: float) -> None:
        if self.alive and not self.stopped and planned_s == self._wakes_at_s:
            self.turn()

    def resume(self) -> None:
        """After SIGSTOP."""
        self.stopped = False
        if self.alive:
            self.turn()

    def turn(self) -> None:
        try:
            self.router.run_once([socket for socket in self.sockets.values() if socket.readable])
        except Crash:
            self.cluster.kill(self, "in the middle of a turn")
            return
        self._wakes_at_s = 0.0
        if any(socket.readable for socket in self.sockets.values()):  # a turn takes some, not all
            self.wake()
        else:
            self._turn_at(self.cluster.clock.now_s + self.router.wait_s() + 1e-6)

    def die(self) -> None:
        self.alive = False
        for socket in self.sockets.values():
            socket.close()


class FragileJournal(Journal):
    """The real one; its process may be killed at it."""

    def __init__(self, db: sqlite3.Connection, broker: Broker) -> None:
        super().__init__(db)
        self._broker = broker

    def append(self, events: list[Event], records: list[m.CommandRecord]) -> None:
        broker = self._broker
        if broker.dies_in_journal == "before":
            raise Crash
        super().append(events, records)
        broker.cluster.journalled(events, records)
        if broker.dies_in_journal == "after":
            raise Crash

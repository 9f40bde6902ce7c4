"""The router with lists in place of its sockets."""

from __future__ import annotations

import sqlite3
from collections import deque
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import zmq

from broker.decisions.events import ProgramInstalled
from broker.decisions.state import State
from broker.persistence import journal as journals
from broker.persistence.journal import Journal
from broker.persistence.program_store import ProgramStore
from broker.router.core import Core
from broker.router.loop import Router
from rtc.programs import loader
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.versions import VERSION
from rtc.runtime.handover import Handover
from rtc.runtime.settings import Settings

ENDPOINTS = ("front", "halt", "workers", "subsystems", "supervisor", "events")

SETTINGS = Settings(run_dir="/nowhere", run="this")

SILENT = SimpleNamespace(info=lambda *_: None, warning=lambda *_: None)


class Frame:
    def __init__(self, data: bytes, more: bool) -> None:
        self.bytes, self.more = data, more


class Socket:
    """A ROUTER of which one sees what lies there and what was sent."""

    def __init__(self) -> None:
        self.inbox: deque[Frame] = deque()
        self.sent: list[list[bytes]] = []
        self._parts: list[bytes] = []

    def put(self, parts: list[bytes]) -> None:
        self.inbox.extend(Frame(part, n + 1 < len(parts)) for n, part in enumerate(parts))

    def getsockopt(self, option: int) -> int:
        assert option == zmq.EVENTS
        return int(zmq.POLLIN)

    def recv(self, flags: int = 0, copy: bool = True) -> Frame:
        if not self.inbox:
            raise zmq.Again
        return self.inbox.popleft()

    def send(self, part: bytes, flags: int = 0) -> None:
        self._parts.append(part)
        if not flags & zmq.SNDMORE:
            self.sent.append(self._parts)
            self._parts = []

    def send_multipart(self, parts: list[bytes], flags: int = 0) -> None:
        self.sent.append(parts)


class Bench:
    def __init__(self, given: Handover | None = None) -> None:
        self.now = 100.0
        self.sockets: dict[str, Socket] = {}
        db = sqlite3.connect(":memory:", isolation_level=None)
        db.executescript(journals.SCHEMA)
        journal = Journal(db)
        journal.snapshot(State())
        me = SimpleNamespace(socket=self._socket, log=SILENT, stopping=False)
        state = State()
        store = ProgramStore(journal, state.programs)
        given = given or Handover(SETTINGS, b"k" * 32)
        core = Core(me, SETTINGS, journal, state, store, given, lambda: self.now)  # type: ignore[arg-type]
        self.router = Router(core)
        for kind in m.WorkerKind:
            digest = store.keep(loader.default(kind))
            self.router.enqueue(ProgramInstalled(at_s=self.now, kind=kind, digest=digest))
        for name in (b"ann", b"bob"):
            hello = m.ClientHello(protocol=VERSION, client=name.decode(), at_s=self.now)
            self.sockets["front"].put([name, *wire.frames(hello)])
        while self.sockets["front"].inbox:
            self.turn()
        for socket in self.sockets.values():
            socket.sent.clear()
        self.turn()

    def _socket(self, _: int, endpoint: str, **__: Any) -> Socket:
        made = self.sockets[Path(endpoint).stem] = Socket()
        return made

    def turn(self, times: int = 1) -> None:
        for _ in range(times):
            self.now += 0.001
            self.router.run_once(None)

    def send(self, endpoint: str, peer: bytes, *messages: Any) -> list[Any]:
        """The answers to this peer, after all messages have been handled."""
        socket = self.sockets[endpoint]
        for message in messages:
            socket.put([peer, *wire.frames(message)])
        socket.sent.clear()
        while socket.inbox:
            self.turn()
        self.turn()
        return [wire.reader(ANSWERS[endpoint])(parts[1:]) for parts in socket.sent if parts[0] == peer]

    @property
    def state(self) -> State:
        return self.router.core.state


ANSWERS: dict[str, Any] = {
    "front": m.BrokerToClient, "halt": m.FromHalt, "workers": m.BrokerToWorker, "subsystems": m.BrokerToSubsystem,
    "supervisor": m.BrokerToSupervisor,
}  # fmt: skip

MCM = m.SubsystemHello(protocol=VERSION, name="MCM", pid=1, performers=["RIGHT-ARM", "LEFT-ARM"])

PARSER = m.WorkerHello(protocol=VERSION, name="parser@0", node=0, kind=m.WorkerKind.PARSER, pid=7)


def forwarded(bench: Bench) -> list[Any]:
    """What the client `ann` has received."""
    return [wire.reader(m.BrokerToClient)(parts[1:]) for parts in bench.sockets["front"].sent if parts[0] == b"ann"]

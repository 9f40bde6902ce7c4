"""Ingress: reads the sockets within limits, and hands each valid message to the handler of its socket.

A loop iteration is short, however many messages are queued, so that the next halt is read soon.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from broker.router.client_messages import ClientMessages
from broker.router.core import Core
from broker.router.egress import Egress
from broker.router.halt_intake import HaltIntake
from broker.router.health import Health
from broker.router.shutdown import ClusterShutdown
from broker.router.subsystem_messages import SubsystemMessages
from broker.router.supervisor_messages import SupervisorMessages
from broker.router.worker_messages import WorkerMessages
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import Refusal, RefusalReason, WireError
from rtc.runtime.halt_admission import read_order
from rtc.runtime.process import inbox, send

# Maximum number of events per socket and iteration. The shares are those of a stream of short commands, so none of its
# messages waits for long. One message of a worker has several results.
MAX_EVENTS = {"halt": 10, "subsystems": 16, "workers": 48, "front": 64}
MAX_MESSAGES = 200  # maximum number of messages per socket and iteration; not all are events
READ_S = 0.003  # time limit per socket and iteration: queries, long and invalid messages take time too
WARNINGS = 20  # dropped messages of one socket that are logged; later only every thousandth is

Read = Callable[[Sequence[bytes]], Sequence[Any]]

_read_halt: Read = lambda parts: (read_order(parts),)  # noqa: E731
_read_subsystem = wire.reader_of_many(m.SubsystemToBroker)
_read_supervisor = wire.reader_of_many(m.SupervisorToBroker)
_read_worker = wire.reader_of_many(m.WorkerToBroker)
_read_client = wire.reader_of_many(m.ClientToBroker)


class Source(NamedTuple):
    """How the messages of one socket are read and handled. `handle(peer, message, now)` may raise WireError."""

    read: Read
    handle: Callable[[bytes, Any, float], None]


class Ingress:
    def __init__(
        self, core: Core, egress: Egress, halts: HaltIntake, health: Health, shutdown: ClusterShutdown
    ) -> None:
        self._core, self._egress = core, egress
        self._sources = {
            "halt": Source(_read_halt, halts.receive),
            "subsystems": Source(_read_subsystem, SubsystemMessages(core, egress, halts, health, shutdown).receive),
            "supervisor": Source(_read_supervisor, SupervisorMessages(core, shutdown).receive),
            "workers": Source(_read_worker, WorkerMessages(core).receive),
            "front": Source(_read_client, ClientMessages(core, egress, health, shutdown).receive),
        }

    def receive(self, name: str, now: float) -> bool:
        """Handle the queued messages of one socket, within the limits. False: there may be more."""
        core, source = self._core, self._sources[name]
        most = MAX_EVENTS.get(name, MAX_MESSAGES)
        messages, began = 0, core.clock()
        for peer, *parts in inbox(core.sockets[name], MAX_MESSAGES):
            messages += 1
            self._handle(name, source, peer, parts, now)
            if len(core.events) >= most or core.clock() - began > READ_S:
                return False
        return messages < MAX_MESSAGES

    def receive_subscriptions(self, now: float) -> None:
        """Subscriptions of the event stream: one frame each, 1 or 0 and the prefix that is wanted."""
        topics = set(self._egress.topics)
        for frame, *_ in inbox(self._core.sockets["events"], MAX_MESSAGES):
            wanted, topic = frame[:1], frame[1:]
            if wanted not in (b"\0", b"\1") or not wire.PROTOCOL.startswith(topic):
                self._core.dropped["events"] += 1
            elif wanted == b"\1":
                topics.add(topic)
            else:
                topics.discard(topic)
        self._egress.set_topics(topics, now)

    def _handle(self, name: str, source: Source, peer: bytes, parts: Sequence[bytes], now: float) -> None:
        """Handle one message, or an array of them. Of an array, only the invalid messages are dropped."""
        try:
            messages = source.read(parts)
        except WireError as error:
            alone = wire.split(parts)
            if len(alone) < 2:
                self._drop(name, peer, parts, error)
                return
            for one in alone:
                self._handle(name, source, peer, one, now)
            return
        for message in messages:
            refusal = self._core.refused_peers.refusal_of(name, peer, message, now)
            if refusal is not None:
                self._refuse(name, peer, message, refusal)
                continue
            try:
                source.handle(peer, message, now)
            except WireError as error:
                self._drop(name, peer, parts, error)

    def _refuse(self, name: str, peer: bytes, message: Any, refusal: Refusal) -> None:
        """Answer a refused peer: its hello, and each request, so that no client waits for an answer."""
        if self._count("refused") and isinstance(message, m.Hello):
            self._core.me.log.warning("refused on %s: %s", name, refusal.message)
        request = getattr(message, "request", "")
        if request or isinstance(message, m.Hello):
            send(self._core.sockets[name], m.Declined(request=request, refusal=refusal), peer)

    def _count(self, name: str) -> bool:
        """Count a dropped message. True if it is worth a line in the log: a flood must not fill it."""
        self._core.dropped[name] += 1
        return self._core.dropped[name] <= WARNINGS or self._core.dropped[name] % 1000 == 0

    def _drop(self, name: str, peer: bytes, parts: Sequence[bytes], error: WireError) -> None:
        """Count and log an invalid message. A client gets a refusal."""
        core = self._core
        if self._count(name):
            core.me.log.warning("dropped a message on %s from %r: %s", name, peer[:40], error)
        if name == "front" and wire.is_hello(parts):  # the answers to what follows it could not be read either
            refusal = Refusal(reason=RefusalReason.VERSION, message=f"the hello of this client cannot be read: {error}")
            core.refused_peers.refuse(name, peer, m.ClientHello(protocol=0, client="unreadable"), refusal, core.clock())
        if name in ("front", "halt"):
            refusal = Refusal(reason=RefusalReason.SENTENCE, message=f"not a message of this protocol: {error}")
            send(core.sockets[name], m.Declined(request=wire.name_in(parts), refusal=refusal), peer)

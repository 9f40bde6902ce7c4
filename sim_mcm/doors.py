"""The MCM's sockets: who may say what to it, bytes to messages and back. Decides nothing.

    estop      ROUTER, bound here: halts and nothing else; works when the broker is dead
    broker     DEALER "MCM": primitives, halts, acknowledgements in; reports out
    telemetry  PUB, bound here
    bench      ROUTER, bound here: truth and belief errors, which only a simulator has

What cannot be read is counted, logged now and then, and dropped: it never stops a tick (R51, and invariant 12).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from typing import Any

import msgspec
import zmq

from rtc import messages as m
from rtc.halt_admission import read_order
from rtc.outcomes import Refusal, RefusalReason, WireError
from rtc.process import Every, Process, inbox, send
from rtc.settings import BOUNDS, NO_HANDOVER, Settings
from rtc.wire import apart, reader
from sim_mcm.subsystem import BROKER, InvalidOrder, Outgoing

# Messages taken from one socket in one tick, so that no sender can stretch it. Callers take turns at a socket, so that
# one who calls without end delays another by one message.
PER_TICK = 20
HALTS_PER_TICK = 10
QUESTIONS_PER_TICK = 1
LOG_EVERY_S = 1.0
NONE: frozenset[Any] = frozenset()

_read_broker = reader(m.BrokerToSubsystem)
_read_bench = reader(m.ToSim)


class Sockets:
    def __init__(self, me: Process, settings: Settings, name: str) -> None:
        self._me, self._log = me, me.log
        self._estop = me.socket(
            zmq.ROUTER, settings.endpoint("estop"), bind=True, bounds=BOUNDS["estop"], handover=False
        )
        self._bench = me.socket(zmq.ROUTER, settings.endpoint("bench"), bind=True, bounds=BOUNDS["bench"])
        self._telemetry = me.socket(zmq.PUB, settings.endpoint("telemetry"), bind=True, bounds=BOUNDS["telemetry"])
        self._broker = me.socket(zmq.DEALER, settings.endpoint("subsystems"), identity=name)
        events = zmq.Event.HANDSHAKE_SUCCEEDED | zmq.Event.DISCONNECTED
        self._monitor = self._broker.get_monitor_socket(events)
        self._poller = zmq.Poller()  # one look at all four costs no more than one at one of them
        for socket in (self._estop, self._broker, self._bench, self._monitor):
            self._poller.register(socket, zmq.POLLIN)
        self._ready: set[Any] | frozenset[Any] = NONE
        self.connected = True  # until the monitor says otherwise: what is said first waits for the broker
        self.dropped: Counter[str] = Counter()  # messages that could not be read, by socket
        self._log_due = Every(LOG_EVERY_S)

    # --- in --------------------------------------------------------------------------------------------

    def reopen(self, settings: Settings) -> None:
        """Somebody has filled our memory: the doors that others come to, with nothing in them."""
        for name in ("estop", "bench"):
            old = getattr(self, f"_{name}")
            self._poller.unregister(old)
            made = self._me.open_anew(old, settings.endpoint(name), BOUNDS[name], handover=name not in NO_HANDOVER)
            self._poller.register(made, zmq.POLLIN)
            setattr(self, f"_{name}", made)

    def poll(self) -> None:
        """See where something lies; once, at the start of a tick."""
        found = self._poller.poll(0)
        self._ready = {socket for socket, _ in found} if found else NONE

    def halts(self, now_s: float) -> Iterator[tuple[bytes, m.HaltOrder]]:
        """What lies at the estop socket: (caller, order). What is no halt is told so."""
        if self._estop not in self._ready:
            return
        for caller, parts in _from_router(self._estop, HALTS_PER_TICK):
            order = self._decode(read_order, parts, "estop", now_s)
            if order is not None:
                yield caller, order
            else:
                words = "the estop socket takes a HaltOrder and nothing else"
                refusal = Refusal(reason=RefusalReason.NOT_ALLOWED, message=words)
                send(self._estop, m.Declined(request="", refusal=refusal), caller)

    def orders(self, now_s: float) -> Iterator[m.Execute | m.HaltOrder | m.ReportAck | InvalidOrder]:
        """What the broker has sent. Of a primitive that is none, what can be read, so that it is answered."""
        if self._broker not in self._ready:
            return
        for parts in chain.from_iterable(map(apart, inbox(self._broker, PER_TICK))):
            order = self._decode(_read_broker, parts, "broker", now_s)
            if isinstance(order, m.Declined):
                self._log.error("the broker does not take us: %s", order.refusal.message)
            elif order is not None:
                yield order
            elif (invalid := invalid_order(parts)) is not None:
                yield invalid

    def questions(self, now_s: float) -> Iterator[tuple[bytes, m.SimTruth | m.SimDisplace | m.SimFactors]]:
        """What the test bench asks."""
        if self._bench not in self._ready:
            return
        for caller, parts in _from_router(self._bench, QUESTIONS_PER_TICK):
            question = self._decode(_read_bench, parts, "bench", now_s)
            if question is not None:
                yield caller, question

    def newly_connected(self) -> bool:
        """True once after every time the broker has been found."""
        if self._monitor not in self._ready:
            return False
        found = False
        for event_frame, *_ in inbox(self._monitor, PER_TICK):
            event = int.from_bytes(event_frame[:2], "little")
            self.connected = found = event == zmq.Event.HANDSHAKE_SUCCEEDED
        self._log.info("broker found" if found else "broker gone; going on alone")
        return found

    # --- out -------------------------------------------------------------------------------------------

    def send(self, out: Outgoing) -> None:
        """To the broker, or to a caller at the estop socket. What cannot be delivered is not kept here."""
        for sender, message in out:
            if sender != BROKER:
                send(self._estop, message, sender)
            elif self.connected:
                send(self._broker, message)

    def answer(self, caller: bytes, message: m.SimTruthReply | m.SimDone) -> None:
        send(self._bench, message, caller)

    def publish(self, telemetry: m.Telemetry) -> None:
        send(self._telemetry, telemetry)

    def _decode(self, read: Callable[[Sequence[bytes]], Any], parts: Sequence[bytes], where: str, now_s: float) -> Any:
        try:
            return read(parts)
        except WireError as error:
            self.dropped[where] += 1
            if self._log_due.due(now_s):
                self._log.warning("%s: dropped a message (%d so far): %s", where, self.dropped[where], error)
            return None


class _PrimitiveHead(msgspec.Struct):
    id: m.Name
    performer: m.Name = ""


class _ExecuteHead(msgspec.Struct, tag="Execute"):
    primitive: _PrimitiveHead
    pid: int = 0


_read_execute = reader(m.Execute)
_read_head = reader(_ExecuteHead)


def invalid_order(parts: Sequence[bytes]) -> InvalidOrder | None:
    """An Execute whose primitive does not decode: its id and what is wrong. None: it is no Execute, or has no id."""
    try:
        head = _read_head(parts)
    except WireError:
        return None
    try:
        _read_execute(parts)
    except WireError as error:
        why = f"it is not a primitive: {error}"
        return InvalidOrder(head.primitive.id, head.primitive.performer, head.pid, why) if head.primitive.id else None
    return None


def _from_router(socket: zmq.Socket[bytes], limit: int) -> Iterator[tuple[bytes, Sequence[bytes]]]:
    for caller, *parts in inbox(socket, limit):
        yield caller, parts

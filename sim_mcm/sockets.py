"""The sockets of the MCM: decodes and encodes messages, limits intake per tick. Makes no decisions.

    estop      ROUTER, bound here: halts and nothing else; works when the broker is dead
    broker     DEALER: primitives, halts, acknowledgements in; reports out
    telemetry  PUB, bound here
    operate    ROUTER, bound here: twists of operators
    bench      ROUTER, bound here: queries of the true state, injected belief errors (simulator only)

A message that does not decode is counted, logged (at most once per second) and dropped. It never stops a tick (R51).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import zmq

from rtc.protocol import messages as m
from rtc.protocol.outcomes import Refusal, RefusalReason, WireError
from rtc.protocol.wire import reader
from rtc.runtime.halt_admission import read_order
from rtc.runtime.process import Every, Process, inbox, send
from rtc.runtime.settings import BOUNDS, NO_HANDOVER, Settings
from rtc.subsystems.base.broker_link import BrokerLink
from rtc.subsystems.base.subsystem import BROKER, Order, Outgoing

# Maximum numbers of messages read from one socket per tick; they bound the tick's duration. ZeroMQ serves callers in
# turn, so a flood by one caller delays another by one message.
HALTS_PER_TICK = 10
QUESTIONS_PER_TICK = 1
OPERATIONS_PER_TICK = 4
LOG_EVERY_S = 1.0
NONE: frozenset[Any] = frozenset()
Question = m.SimTruth | m.SimDisplace | m.SimFactors | m.SimInject | m.SimUndo

_read_bench = reader(m.ToSim)
_read_operate = reader(m.Operate)


class Sockets:
    def __init__(self, me: Process, settings: Settings, name: str, identity: str) -> None:
        self._me, self._log, self._name = me, me.log, name
        self._estop = me.socket(
            zmq.ROUTER, settings.endpoint("estop", name), bind=True, bounds=BOUNDS["estop"], handover=False
        )
        self._bench = me.socket(zmq.ROUTER, settings.endpoint("bench", name), bind=True, bounds=BOUNDS["bench"])
        self._telemetry = me.socket(
            zmq.PUB, settings.endpoint("telemetry", name), bind=True, bounds=BOUNDS["telemetry"]
        )
        self._operate = me.socket(
            zmq.ROUTER, settings.endpoint("operate", name), bind=True, bounds=BOUNDS["operate"], handover=False
        )
        self._link = BrokerLink(me, settings, identity, poll=False)
        self._poller = zmq.Poller()  # polling all costs no more than polling one
        for socket in (self._estop, self._link.socket, self._operate, self._bench, self._link.monitor):
            self._poller.register(socket, zmq.POLLIN)
        self._ready: set[Any] | frozenset[Any] = NONE
        self.dropped = self._link.dropped  # messages that did not decode, by socket
        self._log_due = Every(LOG_EVERY_S)

    # --- in --------------------------------------------------------------------------------------------

    def reopen(self, settings: Settings) -> None:
        """Replace the bound sockets by empty ones, because their queues have filled the memory."""
        for name in ("estop", "operate", "bench"):
            old = getattr(self, f"_{name}")
            self._poller.unregister(old)
            made = self._me.reopen(
                old, settings.endpoint(name, self._name), BOUNDS[name], handover=name not in NO_HANDOVER
            )
            self._poller.register(made, zmq.POLLIN)
            setattr(self, f"_{name}", made)

    def poll(self) -> bool:
        """Find the sockets that have messages. Call once, at the start of a tick."""
        found = self._poller.poll(0)
        self._ready = {socket for socket, _ in found} if found else NONE
        return bool(found)

    def halts(self, now_s: float) -> Iterator[tuple[bytes, m.HaltOrder]]:
        """Halts at the estop socket: (caller, order). Any other message gets Declined."""
        if self._estop not in self._ready:
            return
        for caller, parts in _from_router(self._estop, HALTS_PER_TICK):
            order = self._decode(read_order, parts, "estop", now_s)
            if order is not None:
                yield caller, order
            else:
                words = "this socket accepts only a HaltOrder, with a name as its scope"
                refusal = Refusal(reason=RefusalReason.NOT_ALLOWED, message=words)
                send(self._estop, m.Declined(request="", refusal=refusal), caller)

    def orders(self, now_s: float) -> Iterator[Order]:
        """Messages of the broker. An Execute that does not decode becomes an InvalidOrder, so that it is answered."""
        if self._link.socket in self._ready:
            yield from self._link.orders(now_s)

    def operations(self, now_s: float) -> Iterator[tuple[bytes, m.Operate]]:
        """Messages of operators: (caller, message)."""
        if self._operate not in self._ready:
            return
        for caller, parts in _from_router(self._operate, OPERATIONS_PER_TICK):
            wanted = self._decode(_read_operate, parts, "operate", now_s)
            if wanted is not None:
                yield caller, wanted
            else:
                unread = "it is not a message of this protocol, or has a value of another kind"
                self.answer_operator(caller, m.OperateReply(primitive="", at_s=now_s, refused=unread))

    def questions(self, now_s: float) -> Iterator[tuple[bytes, Question]]:
        """Queries and commands of the test bench: (caller, message)."""
        if self._bench not in self._ready:
            return
        for caller, parts in _from_router(self._bench, QUESTIONS_PER_TICK):
            question = self._decode(_read_bench, parts, "bench", now_s)
            if question is not None:
                yield caller, question

    def newly_connected(self) -> bool:
        """True once after every new connection to the broker."""
        return self._link.monitor in self._ready and self._link.newly_connected()

    # --- out -------------------------------------------------------------------------------------------

    def send(self, out: Outgoing) -> None:
        """Send to the broker or to a caller at the estop socket. Undeliverable messages are dropped."""
        for sender, message in out:
            if sender != BROKER:
                send(self._estop, message, sender)
            else:
                self._link.send([(sender, message)])

    def answer(self, caller: bytes, message: m.SimTruthReply | m.SimDone) -> None:
        send(self._bench, message, caller)

    def answer_operator(self, caller: bytes, message: m.OperateReply) -> None:
        send(self._operate, message, caller)

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


def _from_router(socket: zmq.Socket[bytes], limit: int) -> Iterator[tuple[bytes, Sequence[bytes]]]:
    for caller, *parts in inbox(socket, limit):
        yield caller, parts

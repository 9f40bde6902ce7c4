"""The connection of a subsystem to the broker: decodes orders, encodes reports, notices a new broker.

A message that does not decode is counted, logged (at most once per second) and dropped. An Execute that does not decode
becomes an InvalidOrder, so that it is answered.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain

import msgspec

from rtc.protocol import messages as m
from rtc.protocol.outcomes import WireError
from rtc.protocol.wire import reader, split
from rtc.runtime.link import Link
from rtc.runtime.process import Every, Process, inbox, send
from rtc.runtime.settings import Settings
from rtc.subsystems.base.subsystem import InvalidOrder, Order, Outgoing

PER_TURN = 20  # maximum number of messages read at once
LOG_EVERY_S = 1.0

_read_broker = reader(m.BrokerToSubsystem)


class BrokerLink:
    """Its sockets are polled by `Process.wait`, unless `poll` is False."""

    def __init__(self, me: Process, settings: Settings, identity: str, *, poll: bool = True) -> None:
        self._log = me.log
        self._link = Link.connect(me, settings.endpoint("subsystems"), identity, poll=poll)
        self.socket, self.monitor = self._link.socket, self._link.monitor
        self.dropped: Counter[str] = Counter()  # messages that did not decode
        self._log_due = Every(LOG_EVERY_S)

    def orders(self, now_s: float) -> Iterator[Order]:
        """The messages of the broker."""
        for parts in chain.from_iterable(map(split, inbox(self.socket, PER_TURN))):
            try:
                order = _read_broker(parts)
            except WireError as error:
                self._count(error, now_s)
                if (invalid := invalid_order(parts)) is not None:
                    yield invalid
                continue
            if isinstance(order, m.Declined):
                self._log.error("the broker declined this subsystem: %s", order.refusal.message)
            else:
                yield order

    def newly_connected(self) -> bool:
        """True once after every new connection to the broker."""
        was_lost, found = self._link.lost, self._link.newly_connected()
        if self._link.lost is not was_lost or found:
            self._log.info("broker disconnected; continuing alone" if self._link.lost else "connected to the broker")
        return found and not self._link.lost

    def send(self, out: Outgoing) -> None:
        """Send to the broker; without a connection the messages are dropped."""
        if not self._link.lost:
            for _, message in out:
                send(self.socket, message)

    def _count(self, error: WireError, now_s: float) -> None:
        self.dropped["broker"] += 1
        if self._log_due.due(now_s):
            self._log.warning("broker: dropped a message (%d so far): %s", self.dropped["broker"], error)


class _PrimitiveHead(msgspec.Struct):
    id: m.Name
    performer: m.Name = ""


class _ExecuteHead(msgspec.Struct, tag="Execute"):
    primitive: _PrimitiveHead
    pid: int = 0


_read_execute = reader(m.Execute)
_read_head = reader(_ExecuteHead)


def invalid_order(parts: Sequence[bytes]) -> InvalidOrder | None:
    """An Execute whose primitive does not decode: its id and the error. None if it is not an Execute or has no id."""
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

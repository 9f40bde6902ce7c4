"""Halts from outside: admission at a limited rate, and the answers of the subsystems forwarded to the callers."""

from __future__ import annotations

from collections import OrderedDict, deque

import msgspec

from broker.decisions.events import HaltCalled
from broker.router.core import Core, name_of
from rtc.protocol import messages as m
from rtc.runtime.halt_admission import HaltRateLimiter
from rtc.runtime.process import send

CALLERS_KEPT = 200  # maximum number of callers that get answers
HALTS_OF_CALLER = 8  # latest halts of one caller that are answered


class Halts:
    def __init__(self, core: Core) -> None:
        self._core = core
        self._limiter = HaltRateLimiter()
        self._life = f"{core.began_s * 1e6:.0f}"  # of this broker process: its successor counts from one again
        self.end_halt = f"end-{self._life}"  # name of the halt when the cluster ends
        self._count = 0
        # caller -> (number of the order, the order as it came)
        self.callers: OrderedDict[bytes, deque[tuple[str, m.HaltOrder]]] = OrderedDict()

    def receive(self, peer: bytes, order: m.HaltOrder, now: float) -> None:
        """Admit one order. It gets a number of its own, because callers may repeat names."""
        self._count += 1
        numbered = msgspec.structs.replace(order, call=f"{self._life}-{self._count}")
        if self._limiter.exceeds(peer, now):
            self._limiter.merge(numbered)
            self._core.dropped["halts_folded"] += 1
            return
        self.callers.setdefault(peer, deque(maxlen=HALTS_OF_CALLER)).append((numbered.call, order))
        self.callers.move_to_end(peer)
        if len(self.callers) > CALLERS_KEPT:
            self.callers.popitem(last=False)
        self.enqueue(name_of(peer), numbered, now)

    def enqueue_merged(self, now: float) -> None:
        """Enqueue the merged halt of all orders above the rate, if it is due."""
        if (merged := self._limiter.due(now)) is not None:
            self.enqueue("", merged, now)

    def enqueue(self, client: str, order: m.HaltOrder, now: float) -> None:
        self._core.enqueue(
            HaltCalled(
                at_s=now,
                client=client,
                halt=order.halt,
                scope=order.scope,
                called_at_s=order.called_at_s,
                call=order.call,
                received_at_s=order.received_at_s,
            )
        )

    def moves(self, subsystem: str) -> bool:
        """False for a subsystem that has cameras only."""
        found = self._core.state.subsystems.get(subsystem)
        return found is None or not found.queues or set(found.queues) != set(found.performers)

    def answer(self, message: m.HaltStarted | m.HaltAtRest) -> None:
        """Forward a subsystem's answer to the callers: by the order's number, or by name if it has none.

        A caller must not take the rest of cameras for the rest of arms. So S&P answers only for its own performers, and
        not to a caller of ALL."""
        reached = message.moving if isinstance(message, m.HaltStarted) else message.performers
        still = not self.moves(message.subsystem)
        for peer, called in self.callers.items():
            for call, order in called:
                if still and (order.scope == "ALL" or not reached):
                    continue
                if message.call == call or (not message.call and message.halt == order.halt):
                    send(self._core.sockets["halt"], msgspec.structs.replace(message, call=order.call), peer)

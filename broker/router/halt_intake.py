"""Halts from outside: admission at a limited rate, and the answers of the subsystems forwarded to the callers."""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass

import msgspec

from broker.decisions.events import HaltCalled
from broker.router.core import Core, name_of
from rtc.protocol import messages as m
from rtc.runtime.halt_admission import HaltRateLimiter, overload
from rtc.runtime.process import send

CALLERS_KEPT = 200  # maximum number of callers that get answers
HALTS_OF_CALLER = 8  # latest halts of one caller that are answered
AGAIN_S = 10.0  # age up to which an unanswered halt is sent to a new process of the subsystem; its start takes 0.1 s


@dataclass
class Called:
    """A halt of one caller. `call`: our number for it; `order`: as it came."""

    call: str
    order: m.HaltOrder
    at_s: float
    answered: bool = False  # a subsystem has reported whether all in its scope is at rest


class HaltIntake:
    def __init__(self, core: Core) -> None:
        self._core = core
        self._limiter = HaltRateLimiter()
        self._life = f"{core.began_s * 1e6:.0f}"  # of this broker process: its successor counts from one again
        self.end_halt = f"end-{self._life}"  # name of the halt when the cluster ends
        self._count = 0
        self.callers: OrderedDict[bytes, deque[Called]] = OrderedDict()

    def receive(self, peer: bytes, order: m.HaltOrder, now: float) -> None:
        """Admit one order. It gets a number of its own, because callers may repeat names."""
        self._count += 1
        numbered = msgspec.structs.replace(order, call=f"{self._life}-{self._count}")
        if self._limiter.exceeds(peer, now):
            self._limiter.merge(numbered)
            self._core.dropped["halts_merged"] += 1
            send(self._core.sockets["halt"], overload(order, "too many calls in a short time"), peer)
            return
        self.callers.setdefault(peer, deque(maxlen=HALTS_OF_CALLER)).append(Called(numbered.call, order, now))
        self.callers.move_to_end(peer)
        if len(self.callers) > CALLERS_KEPT:
            self.callers.popitem(last=False)
        self.enqueue(name_of(peer), numbered, now)

    def enqueue_merged(self, now: float) -> None:
        """Enqueue the merged halt of all orders above the rate, if it is due."""
        if (merged := self._limiter.due(now)) is not None:
            self.enqueue("", merged, now)

    def enqueue(self, client: str, order: m.HaltOrder, now: float) -> None:
        self._core.enqueue(HaltCalled(at_s=now, client=client, order=order))

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
            for one in called:
                if still and (one.order.scope == "ALL" or not reached):
                    continue
                if message.call == one.call or (not message.call and message.halt == one.order.halt):
                    send(self._core.sockets["halt"], msgspec.structs.replace(message, call=one.order.call), peer)
                    one.answered |= isinstance(message, m.HaltAtRest)

    def unanswered(self, hello: m.SubsystemHello, now: float) -> list[m.HaltOrder]:
        """The halts that the former process of a subsystem took with it: its successor is at rest and can confirm that.

        They stop nothing of later commands: a new process has not begun anything before they arrive."""
        known = self._core.state.subsystems.get(hello.name)
        if known is not None and known.pid == hello.pid:
            return []  # it has received them, and answers
        scopes = {"ALL", *hello.performers}
        return [
            msgspec.structs.replace(one.order, call=one.call)
            for called in self.callers.values()
            for one in called
            if not one.answered
            and now - one.at_s <= AGAIN_S
            and (one.order.scope in scopes or one.order.scope.startswith("C-"))
        ]

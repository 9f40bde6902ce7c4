"""What really happened at the MCM of the simulated cluster, and what it proves wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rtc.protocol import messages as m
from rtc.protocol.outcomes import StopReason
from rtc.subsystems.motion.modes import Mode

if TYPE_CHECKING:
    from tests.simulation.cluster import Cluster
    from tests.simulation.processes import Mcm


class Ledger:
    """What really happened at the MCM, whatever the broker believes; and what it proves wrong."""

    def __init__(self, cluster: Cluster) -> None:
        self.cluster = cluster
        self.begun: dict[str, float] = {}
        self.ended: dict[str, StopReason] = {}
        self.halts: list[tuple[Mcm, m.HaltOrder, float]] = []  # process that received it, order, time
        self.last_halt_s: dict[str, float] = {}  # scope -> when the last called one was received by any process

    def halted(self, mcm: Mcm, order: m.HaltOrder, now_s: float) -> None:
        self.halts.append((mcm, order, now_s))
        if not order.halt.startswith(("stop-", "orphan-", "rejoin-")):
            self.last_halt_s[order.scope] = now_s

    def obeyed(self, mcm: Mcm, order: m.HaltOrder) -> None:
        """Called when the MCM has just received a halt: nothing in its scope may continue, whatever its name."""
        for executor in mcm.subsystem.executors.values():
            primitive = executor.primitive_id
            in_scope = order.scope in ("ALL", executor.name, primitive.partition(".")[0])
            if in_scope and executor.state is Mode.EXECUTING:
                self.cluster.wrong(f"halt {order.halt} of {order.scope} was received, and {primitive} continues")

    def sent(self, mcm: Mcm, message: m.Message) -> None:
        if isinstance(message, m.Started):
            if message.primitive in self.begun:
                self.cluster.wrong(f"{message.primitive} was executed twice")
            self.begun[message.primitive] = message.at_s
            self._not_after_a_halt(mcm, message)
        elif isinstance(message, m.HaltAtRest) and message.at_rest:
            moving = [n for n in message.performers if mcm.subsystem.executors[n].primitive_id]
            if moving:
                self.cluster.wrong(f"halt {message.halt}: {moving} reported at rest, and executing")
        elif isinstance(message, m.EndReport):
            known = self.ended.setdefault(message.primitive, message.reason)
            if known is not message.reason:
                self.cluster.wrong(f"{message.primitive} ended {known.value}, and {message.reason.value}")

    def _not_after_a_halt(self, mcm: Mcm, started: m.Started) -> None:
        command = started.primitive.partition(".")[0]
        sent_s, accepted_s = self.cluster.given(command)
        executor = next(e for e in mcm.subsystem.executors.values() if e.primitive_id == started.primitive)
        for mcm_then, order, at_s in self.halts:
            if mcm_then is not mcm or at_s > started.at_s or order.scope not in ("ALL", executor.name, command):
                continue
            # A number means nothing before it is given out.
            if (accepted_s if order.scope == command else sent_s) < order.called_at_s:
                self.cluster.wrong(
                    f"{started.primitive} began at {started.at_s:.4f}, after halt {order.halt} of {order.scope}"
                )

    def of(self, command: str) -> list[str]:
        return [primitive for primitive in self.begun if primitive.partition(".")[0] == command]

"""Messages at the supervisor's socket: process table, exits, the order to end, and drop counts of other processes."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

from broker.decisions.events import SubsystemGone
from broker.router.core import Core
from broker.router.shutdown import ClusterShutdown
from rtc.protocol import messages as m
from rtc.protocol.outcomes import WireError
from rtc.runtime.process_table import in_words

GATEWAY = b"gate"
#: process that reports dropped messages at this socket -> its own counters
DROP_COUNTERS: dict[bytes, tuple[str, ...]] = {
    b"world": ("world",),
    GATEWAY: ("gate_strangers", "gate_unreadable", "gate_refused", "gate_nameless", "gate_unsent", "gate_stale"),
}


class SupervisorMessages:
    def __init__(self, core: Core, shutdown: ClusterShutdown) -> None:
        self._core, self._shutdown = core, shutdown

    def receive(self, peer: bytes, message: Any, now: float) -> None:
        """Raises WireError for a peer that is not the supervisor."""
        if isinstance(message, m.ProcessHello) and peer in DROP_COUNTERS:
            return  # it states its version, which was read
        if isinstance(message, m.UnreadableMessages) and peer in DROP_COUNTERS:
            count_dropped(self._core, message, DROP_COUNTERS[peer])
            return
        if isinstance(message, m.GatewayReport) and peer == GATEWAY:
            self._core.peers, self._core.peers_at_s = message.peers, now
            return
        if peer != self._core.supervisor_peer or type(message) not in HANDLERS:
            raise WireError("the sender is not the supervisor")
        self._core.supervised = True
        HANDLERS[type(message)](self, message, now)

    def _connect(self, message: m.ProcessHello, now: float) -> None:
        self._core.me.log.info("the supervisor is connected")

    def _exited(self, message: m.ProcessExited, now: float) -> None:
        core, name = self._core, message.name
        core.me.log.warning("%.80r (pid %d) %s", name, message.pid, in_words(message.status))
        called = f", after it called the {message.called} of an installed package" if message.called else ""
        worker = core.registry.workers.get(name)
        if worker is not None and worker.pid == message.pid:
            lost = core.registry.remove(name)
            core.lose_jobs(name, lost, f"exit status {message.status}{called}", now, message.called)
        subsystem = core.state.subsystems.get(name)
        if subsystem is not None and subsystem.pid == message.pid:
            why = f"its process {in_words(message.status)}{called}"
            core.enqueue(SubsystemGone(at_s=now, subsystem=name, why=why))

    def _end_cluster(self, message: m.Shutdown, now: float) -> None:
        self._shutdown.begin(now)

    def _replace_table(self, message: m.ProcessTable, now: float) -> None:
        self._core.processes = message.processes
        self._core.processes_at_s = now
        self._core.asked = message.asked


def count_dropped(core: Core, message: m.UnreadableMessages, sockets: Collection[str]) -> None:
    """Store the drop counts that a process reports for its own sockets."""
    core.reported_drops.update((name, n) for name, n in message.counts.items() if name in sockets)


HANDLERS: dict[type, Callable[[SupervisorMessages, Any, float], None]] = {
    m.ProcessHello: SupervisorMessages._connect,
    m.ProcessExited: SupervisorMessages._exited,
    m.Shutdown: SupervisorMessages._end_cluster,
    m.ProcessTable: SupervisorMessages._replace_table,
}

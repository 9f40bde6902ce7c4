"""Health: what only the clock shows. Hung workers, lost subsystems and clients, expired jobs, memory, snapshots."""

from __future__ import annotations

import msgspec

from broker.decisions.events import ClientGone, JobDeclined, SubsystemGone
from broker.decisions.state import LinkState
from broker.dispatch.autoscaler import Autoscaler
from broker.dispatch.more_workers import MoreWorkers
from broker.dispatch.worker_registry import LostJob
from broker.router.core import Core, peer_of
from broker.router.egress import Egress
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.runtime.memory_guard import MemoryGuard
from rtc.runtime.process import Every
from rtc.runtime.settings import BOUNDS, NO_HANDOVER

SUBSYSTEM_SILENCE_S = 2.0  # time limit for a sign of life of a subsystem; then it is lost
SUBSYSTEM_DEAF_S = 5.0  # a subsystem that is lost for so long although its process runs is restarted
CLIENT_SILENCE_S = 5.0  # time limit for a sign of life of a client whose commands depend on it
SNAPSHOT_S, WORTH_A_SNAPSHOT = 10.0, 2_000  # period of snapshots, and the least number of events for one


class Health:
    """`guard`: limits the memory of this process; None in a simulation."""

    def __init__(self, core: Core, egress: Egress, guard: MemoryGuard | None) -> None:
        self._core, self._egress, self._guard = core, egress, guard
        given = core.settings
        self._autoscaler = Autoscaler(given.least, given.most)
        self._more_workers = MoreWorkers(given.more, given.most, given.scale_out_max, given.scale_out_timeout_s)
        self._snapshots = Every(SNAPSHOT_S)
        self.subsystem_seen_s: dict[str, float] = {}  # subsystem -> time of its latest message
        # Clients whose commands are halted when they disappear -> time of the latest sign of life.
        self.client_seen_s = {c.client: core.began_s for c in core.state.commands.values() if c.halt_if_lost}

    def check(self, now: float) -> None:
        """Check everything once; call it about ten times a second."""
        if self._guard is not None and (stage := self._guard.alarm(now)):
            self._reset_sockets(stage, now)
        self._tidy_journal(now)
        self._check_workers(now)
        self._check_unregistered(now)
        self._scale(now)
        self._expire_jobs(now)
        self._check_clients(now)
        self._check_subsystems(now)

    def _tidy_journal(self, now: float) -> None:
        journal = self._core.journal
        journal.tidy()
        if self._snapshots.due(now) and journal.events_since_snapshot >= WORTH_A_SNAPSHOT:
            journal.snapshot(self._core.state)

    def _check_workers(self, now: float) -> None:
        for worker, why in self._core.registry.hung(now):
            self._kill(worker.name, worker.pid, why)
            self._core.lose_jobs(worker.name, self._core.registry.remove(worker.name), why, now)

    def _check_unregistered(self, now: float) -> None:
        """Worker processes that are ready and have not registered with this broker."""
        core = self._core
        for n, process in enumerate(core.processes):
            if core.refused_peers.is_refused("workers", peer_of(process.name)):
                continue  # another process of this version would be refused too
            ready_since_s = max(core.began_s, process.since_s)
            if process.state == "ready" and core.registry.never_registered(process.name, ready_since_s, now):
                core.processes[n] = msgspec.structs.replace(process, state="hung")
                self._kill(process.name, process.pid, "hung: it has not sent anything to this broker")

    def _scale(self, now: float) -> None:
        if self._core.supervised:
            core = self._core
            scaled = self._autoscaler.orders(core.registry, core.processes, now)
            asked = self._more_workers.orders(core.registry, core.processes, core.asked, now)
            for order in (*scaled, *asked):
                core.me.log.info("%s", order)
                self._egress.send_supervisor(order)

    def _expire_jobs(self, now: float) -> None:
        for job in self._core.registry.waited_too_long(now):
            message = f"no {job.queue} took the job within the limit; is one alive? see `rtc status`"
            refusal = Refusal(reason=RefusalReason.TIMEOUT, message=message)
            self._core.enqueue(JobDeclined(at_s=now, job=job.job, attempt=job.attempt, node="broker", refusal=refusal))

    def _check_clients(self, now: float) -> None:
        for name in [name for name, seen_s in self.client_seen_s.items() if now - seen_s > CLIENT_SILENCE_S]:
            del self.client_seen_s[name]
            self._core.enqueue(ClientGone(at_s=now, client=name))

    def _check_subsystems(self, now: float) -> None:
        known = self._core.state.subsystems
        for name in self.subsystem_seen_s.keys() - known.keys():
            del self.subsystem_seen_s[name]
        for name, subsystem in known.items():
            silent_s = now - self.subsystem_seen_s.get(name, self._core.began_s)
            if subsystem.link is not LinkState.LOST and silent_s > SUBSYSTEM_SILENCE_S:
                self._core.enqueue(SubsystemGone(at_s=now, subsystem=name, why=f"silent for {silent_s:.1f} s"))
            elif subsystem.link is LinkState.LOST and silent_s > SUBSYSTEM_DEAF_S:
                self._restart_deaf(name, subsystem.pid, silent_s, now)

    def _restart_deaf(self, name: str, pid: int, silent_s: float, now: float) -> None:
        """Have a subsystem restarted whose connection is lost although its process runs."""
        if self._core.refused_peers.is_refused("subsystems", self._core.subsystem_peer(name)):
            return
        for row in self._core.processes:
            if (row.name, row.pid, row.state) == (name, pid, "ready"):
                self.subsystem_seen_s[name] = now  # so that it is ordered once per period
                self._kill(name, pid, f"lost to the broker for {silent_s:.1f} s, although it runs")

    def _kill(self, name: str, pid: int, why: str) -> None:
        self._core.me.log.warning("%s (pid %d) %s", name, pid, why)
        self._egress.send_supervisor(m.KillProcess(name=name, pid=pid, why=why))

    def _reset_sockets(self, stage: int, now: float) -> None:
        """Close and bind sockets that fill the memory. Legitimate peers reconnect and repeat unanswered messages."""
        assert self._guard is not None
        core = self._core
        names = ("front", "halt") if stage == 1 else ("events", "supervisor", "workers", "subsystems")
        core.me.log.warning("more than %.0f MB: opening %s anew", self._guard.limit_mb, ", ".join(names))
        for name in names:
            core.sockets[name] = core.me.reopen(
                core.sockets[name], core.settings.endpoint(name), BOUNDS[name], handover=name not in NO_HANDOVER
            )
        if "events" in names:
            self._egress.set_topics(set(), now)
        if "workers" in names:  # jobs that were in the socket are lost
            for worker in list(core.registry.workers):
                lost = [LostJob(one.job, in_hand=False) for one in core.registry.remove(worker)]
                core.lose_jobs(worker, lost, "its connection was cut", now)

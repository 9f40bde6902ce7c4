"""The broker's loop: receive, decide, journal, perform. It turns messages into events and makes no decisions.

Each iteration reads the sockets in order of priority: halts, subsystems, supervisor, workers, clients. Halts form a
batch of their own: they are decided, journalled and sent before anything else is read. The events of a batch are
journalled in one transaction before any of its effects is performed (ARCHITECTURE, "What must always hold", 7).
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from broker.decisions import effects as do
from broker.decisions.decide import decide_batch
from broker.decisions.events import Event, JobDeclined, ProgramInstalled, SubsystemGone, TimerFired
from broker.router import part_loads
from broker.router.arms_in_motion import ArmsInMotion
from broker.router.core import Core
from broker.router.egress import Egress
from broker.router.halt_intake import HaltIntake
from broker.router.health import Health
from broker.router.ingress import Ingress
from broker.router.shutdown import ClusterShutdown
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.runtime.memory_guard import MemoryGuard
from rtc.runtime.process import Every

ORPHAN_LIMIT_S = 1.2  # time limit for the outcomes of all commands after the supervisor's death, at full speed
STALL_S = 1.0  # a gap between two iterations that shows that this process or the machine was suspended
CHECK_S = 0.1  # period of the health checks
PROGRAM_POLL_S = 0.02  # period of polls for the check of a program
SNAPSHOT_EVENTS = 30_000  # a restarted broker replays so many events in well under a second


class Router:
    def __init__(self, core: Core, guard: MemoryGuard | None = None) -> None:
        self.core = core
        self.egress = Egress(self.core)
        self.halts = HaltIntake(self.core)
        self._arms_in_motion = ArmsInMotion(self.core)
        self._shutdown = ClusterShutdown(self.core, self.egress, self.halts)
        self._health = Health(self.core, self.egress, guard)
        self._ingress = Ingress(self.core, self.egress, self.halts, self._health, self._shutdown)
        self._iteration_s = self.core.began_s  # start of the latest iteration
        self._checks = Every(CHECK_S)

    def enqueue(self, event: Event) -> None:
        """Add an event that does not come from a socket."""
        self.core.enqueue(event)

    def run(self) -> None:
        """Run until the process is to stop. A broker whose supervisor has died ends its commands first."""
        me = self.core.me
        while not me.stopping:
            self.run_once(me.wait(self.wait_s()))
        if me.orphaned:
            self._end_orphaned()
        else:
            self.core.journal.snapshot(self.core.state)
        self.egress.stream.flush()

    def wait_s(self) -> float:
        """How long the next iteration may wait for messages, in seconds."""
        now = self.core.clock()
        wait_s = self._checks.left_s(now)
        if self.core.loads.busy:
            wait_s = min(wait_s, PROGRAM_POLL_S)
        if (timer_s := self.core.timers.next_at_s()) is not None:
            wait_s = min(wait_s, max(0.0, timer_s - now))
        if (stream_s := self.egress.stream.left_s(now)) is not None:
            wait_s = min(wait_s, stream_s)
        return wait_s

    def run_once(self, readable: Collection[Any] | None = None) -> None:
        """One iteration. `readable`: the sockets that have something to read; None: try all."""
        core = self.core
        began = core.clock()
        waiting = [name for name, socket in core.sockets.items() if readable is None or socket in readable]
        if "halt" in waiting:
            self._ingress.receive("halt", began)
        self.halts.enqueue_merged(began)
        if core.events:
            self._settle(began)
        reports_read = self._receive(waiting, began)
        if reports_read:  # otherwise the report that a timer waits for may be queued
            core.events += [TimerFired(at_s=began, timer=name) for name in core.timers.due(began)]
        stalled = began - self._iteration_s > STALL_S  # after a stall peers only seem silent
        self._iteration_s = began
        if core.loads.busy:
            self._install_programs(began)
        if self._checks.due(began) and not stalled:
            self._health.check(began)
        if core.events:
            self._settle(began)
            self._shutdown.report()
            core.loop_times_s.append(core.clock() - began)
        else:
            self.egress.assign_jobs(began)
        self._arms_in_motion.state_changes()
        self.egress.stream.flush_if_due(began)

    def _receive(self, waiting: Collection[str], now: float) -> bool:
        """Receive from the sockets in `waiting` except `halt`. False: reports of subsystems may still be queued."""
        reports_read = True
        for name in waiting:
            if name == "events":
                self._ingress.receive_subscriptions(now)
            elif name != "halt":
                all_read = self._ingress.receive(name, now)
                reports_read &= all_read or name != "subsystems"
        return reports_read

    def _settle(self, now: float) -> None:
        """Decide all events of this batch, journal them, then perform the effects."""
        core = self.core
        events, core.events = core.events, []
        effects = decide_batch(core.state, events)
        core.journal.append(events, [e.record for e in effects if type(e) is do.ReportEnd])
        self.egress.perform(effects)
        self.egress.assign_jobs(now)
        if core.journal.events_since_snapshot >= SNAPSHOT_EVENTS:
            core.journal.snapshot(core.state)

    def _install_programs(self, now: float) -> None:
        """Install the programs whose check has ended. Each is decided and journalled before its client is answered."""
        for asker, text, loaded in self.core.loads.poll(now):
            if not isinstance(loaded, Refusal):
                self.enqueue(
                    ProgramInstalled(
                        at_s=now, kind=text.kind, digest=loaded.digest, file=text.name, changes=loaded.changes
                    )
                )
                self._settle(now)
            if isinstance(asker, do.LoadPart):  # a sentence
                self.enqueue(part_loads.answer(asker, text, loaded, now))
            elif isinstance(loaded, Refusal):
                self.egress.decline(asker, text.request, loaded)
            else:
                kind, changes = text.kind, loaded.changes
                answer = m.ProgramLoaded(request=text.request, kind=kind, digest=loaded.digest, changes=changes)
                self.egress.answer(asker, answer)

    # --- after the supervisor's death -----------------------------------------------------------------

    def _end_orphaned(self) -> None:
        """Halt everything and send every client its outcomes. The MCM brakes by itself and reports. The workers are
        dead, so the last analyses are given up. This journal is not continued."""
        core = self.core
        limit_s = core.clock() + ORPHAN_LIMIT_S * core.settings.timeout_scale
        self._shutdown.begin(core.clock())
        self.run_once()
        while core.state.commands and (left_s := limit_s - core.clock()) > 0.0:
            self._give_up_analyses()
            self.run_once(core.me.wait(0.0 if core.events else min(left_s, self.wait_s())))
        if core.state.commands:
            why, now = "it gave no report after the supervisor's death", core.clock()
            core.events += [SubsystemGone(at_s=now, subsystem=name, why=why) for name in core.state.subsystems]
            self.run_once(())
            self._give_up_analyses()
            self.run_once(())

    def _give_up_analyses(self) -> None:
        refusal = Refusal(reason=RefusalReason.TIMEOUT, message="the workers have died with the supervisor")
        self.core.events += [
            JobDeclined(
                at_s=self.core.clock(), job=command.job.id, attempt=command.job.attempt, node="broker", refusal=refusal
            )
            for command in self.core.state.commands.values()
            if command.job is not None
        ]

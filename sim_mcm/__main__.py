"""The process of the simulated MCM: `python -m sim_mcm --run-dir D` runs its arms (pybullet or kinematic) at 1 kHz.

With --template it is the fork server of the MCM, with libraries and cell already loaded.

Order in every tick: halts, messages of the broker, one servo tick, one simulation step. A tick never waits. Faster than
real time, ticks within a millisecond share one look at the sockets.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path

from rtc.model.cells.cell import Cell
from rtc.plugins import guard, registry
from rtc.protocol import messages as m
from rtc.protocol.subsystems import ARMS
from rtc.runtime import fork_server, handover, process, time_limit
from rtc.runtime.memory_guard import MemoryGuard, limit_data
from rtc.runtime.settings import Settings
from rtc.subsystems.base.item_process import ItemProcess
from rtc.subsystems.base.report_items import measured
from rtc.subsystems.base.subsystem import BROKER, Outgoing
from rtc.subsystems.motion.arm import Simulation
from rtc.subsystems.motion.subsystem import McmSubsystem
from sim_mcm.clock import Clock
from sim_mcm.faults import FARTHEST, Injections
from sim_mcm.period import period
from sim_mcm.sockets import Question, Sockets
from sim_mcm.state_file import StateFile

HEARTBEAT_S = 0.25
TELEMETRY_S = 0.02
# If the process runs faster than real time: minimum time between two looks at the sockets, and between two times of
# other work.
READ_S, WORK_S = 0.001, 0.005
TICKS_AT_ONCE = 8  # between two readings of the clock, if it runs as fast as it can
NOTHING: Outgoing = []
END_S = 1.0  # simulated: maximum time for the arms to come to rest before the process ends
LAST_S = 1.0  # for the rest of that end
RANK, NICENESS = 2, -5  # above the broker and the workers, if the system permits it
# With real-time priority and too little time for its ticks it would leave none to others: it does without for so long.
MODEST_S = 30.0
IO_RANK = 1  # of its I/O threads: below the servo tick, so that a flood of messages does not delay it


def _bullet(cell: Cell) -> Simulation:
    from sim_mcm.arms.bullet_arm import BulletCell  # exact arms need no physics library

    return BulletCell(cell)


def _kinematic(cell: Cell) -> Simulation:
    from sim_mcm.arms.kinematic_arm import KinematicCell

    simulation = KinematicCell(cell)
    simulation.watch.prepare()
    return simulation


SIMULATIONS: dict[str, Callable[[Cell], Simulation]] = {"bullet": _bullet, "kinematic": _kinematic}


class SimulationLoop:
    """The loop around a simulation: sockets, subsystem, clock."""

    def __init__(self, me: process.Process, name: str, given: handover.Handover, simulation: Simulation) -> None:
        settings = given.settings
        self._name = name
        self._me, self._settings = me, settings
        self._guard = MemoryGuard()
        self._simulation = simulation
        self._state_file = StateFile(settings.path, settings.run, name)
        if (before := self._state_file.load()) is not None:
            simulation.restore(before)
        measure = ItemProcess().measure if registry.names(registry.REPORT_ITEMS) else measured
        self._subsystem = McmSubsystem(self._simulation.arms, name, os.getpid(), measure)
        self._faults = Injections(self._simulation.cell, self._simulation, self._subsystem.executors)
        self._sockets = Sockets(me, settings, name, given.identity(name))
        self._clock = Clock(settings.speed, process.now_s())
        self._heartbeat = process.Every(HEARTBEAT_S)
        self._telemetry = process.Every(TELEMETRY_S)
        self._read_s, self._work_s = (0.0, 0.0) if _in_real_time(settings) else (READ_S, WORK_S)
        self._read_at_s = 0.0  # when the sockets are read next
        self._work_at_s = 0.0  # when the work between ticks is due
        self._busy = True  # a primitive runs or waits
        self._modest_until_s = 0.0  # without real-time priority; 0: with it
        self._called: list[str] = []  # code of packages that has run in this process
        guard.tell(self._calls)

    def run(self) -> None:
        """Run until the process receives the order to stop."""
        clock, subsystem = self._clock, self._subsystem
        self._sockets.send([*subsystem.hello(), self._injected])
        process.freeze_heap()
        self._me.ready()
        while not self._me.stopping:
            now_s = process.now_s()
            left_s = clock.left_s(now_s, self._busy)
            if left_s > 0.0:
                time.sleep(left_s)
                now_s = process.now_s()
            if now_s < self._read_at_s:  # ticks faster than real time
                quick = clock.free_running and not self._faults.tick_s
                for _ in range(TICKS_AT_ONCE if quick else 1):
                    clock.begin(now_s)
                    self._move(now_s)
            else:
                self._tick(now_s)
        self._come_to_rest()
        self._me.log.info("%d ticks, %d late", clock.ticks, clock.late_ticks)

    def _come_to_rest(self) -> None:
        """Brake all arms before the process ends, also if the supervisor has died. Telemetry shows the rest."""
        subsystem, limit_s = self._subsystem, process.now_s() + END_S * self._settings.timeout_scale
        process.end_within(END_S * self._settings.timeout_scale + LAST_S)
        if not subsystem.at_rest:
            self._me.log.info("braking before the end")
        subsystem.brake()
        while not subsystem.at_rest and (now_s := process.now_s()) < limit_s:
            self._clock.begin(now_s)
            self._move(now_s)
            if self._telemetry.due(now_s):
                self._sockets.publish(self._look(now_s))
            time.sleep(max(0.0, self._clock.left_s(process.now_s(), busy=True)))
        self._sockets.publish(self._look(process.now_s()))

    def _tick(self, now_s: float) -> None:
        self._clock.begin(now_s)
        self._read_at_s = now_s + self._read_s
        found, answers = self._sockets.poll(), NOTHING
        if found:
            answers = self._receive(now_s)
            now_s = process.now_s()  # a halt may have been called after this tick began
        self._busy = not self._subsystem.idle  # between two looks at the sockets it can only become idle
        self._move(now_s, answers)
        self._log_started(answers)
        if found or now_s >= self._work_at_s:
            self._work_at_s = now_s + self._work_s
            self._between_ticks(now_s)

    def _calls(self, name: str) -> None:
        """Code of a package begins (or has ended, ""): if it ends this process, the message about that names it."""
        if name and name not in self._called:
            self._called.append(name)
            self._me.calls(", ".join(self._called))

    def _receive(self, now_s: float) -> Outgoing:
        """Obey halts, then the orders of the broker. The answers are sent after the tick: an arm brakes first."""
        sockets, subsystem, answers = self._sockets, self._subsystem, list[tuple[bytes, m.Message]]()
        for caller, halt in sockets.halts(now_s):
            answers += subsystem.handle(halt, caller, process.now_s())
        for order in sockets.orders(now_s):
            answers += subsystem.handle(order, BROKER, now_s)
        for caller, wanted in sockets.operations(now_s):
            sockets.answer_operator(caller, subsystem.operate(wanted, caller, now_s))
        return answers

    def _move(self, now_s: float, answers: Outgoing = NOTHING) -> None:
        """One servo tick and one simulation step. `answers`: what is sent before its reports."""
        out = [*answers, *period(self._subsystem.tick, self._simulation, now_s)]
        if self._faults.advances and self._faults.advance():
            self._sockets.send([self._injected])
        if out:
            if any(isinstance(message, m.EndReport) for _, message in out):
                self._state_file.save(self._simulation.state())  # a reported state survives a restart
            self._sockets.send(out)
        if self._faults.tick_s:
            time.sleep(self._faults.tick_s)

    def _between_ticks(self, now_s: float) -> None:
        """Work that is not urgent."""
        sockets = self._sockets
        if self._clock.overloaded() or self._modest_until_s:
            self._share_processor(now_s)
        self._me.beat(now_s)
        if sockets.newly_connected():
            sockets.send([*self._subsystem.hello(), self._injected])
        if self._heartbeat.due(now_s):
            sockets.send([(BROKER, m.Heartbeat(name=self._name, own_s=self._clock.sim_s))])
            if sockets.dropped:
                sockets.send([(BROKER, m.UnreadableMessages(counts=dict(sockets.dropped)))])
            if self._guard.alarm(now_s):
                self._me.log.warning("more than %.0f MB: opening estop and bench anew", self._guard.limit_mb)
                sockets.reopen(self._settings)
        if self._telemetry.due(now_s):
            sockets.publish(self._look(now_s))
            self._state_file.save(self._simulation.state())
        for caller, question in sockets.questions(now_s):
            sockets.answer(caller, self._answer(question))
            if isinstance(question, m.SimInject | m.SimUndo):
                self._me.log.info("injected faults: %s", "; ".join(self._faults.active) or "none")
                sockets.send([self._injected])

    def _share_processor(self, now_s: float) -> None:
        """Give up real-time priority while the processors do not suffice for all who have it, and request it again."""
        if not self._modest_until_s:
            if not process.lower_priority():
                return
            self._modest_until_s = now_s + MODEST_S
            self._me.log.warning("too slow for real time: for %g s without real-time priority", MODEST_S)
        elif now_s >= self._modest_until_s:
            self._modest_until_s = 0.0
            self._me.log.info("scheduling: %s", _raise_priority(self._settings))

    @property
    def _injected(self) -> tuple[bytes, m.Injected]:
        return BROKER, m.Injected(active=self._faults.active)

    def _log_started(self, out: Outgoing) -> None:
        """Log every started primitive: the log shows, over all MCM processes, whether one ran twice."""
        for _, message in out:
            if isinstance(message, m.Started):
                self._me.log.info("begins %s", message.primitive)

    def _look(self, now_s: float) -> m.Telemetry:
        arms = {}
        for name, executor in self._subsystem.executors.items():
            sample = executor.sample
            arms[name] = m.ArmSample(
                joints=sample.joints,
                velocities=sample.velocities,
                wrench=executor.wrench,
                tcp_pose=executor.arm.tcp_pose(sample.joints).tolist(),
                hand_width_m=sum(sample.fingers),
                primitive=executor.primitive_id,
                operation=executor.operated.look() if executor.operated is not None else None,
            )
        clock = self._clock
        return m.Telemetry(
            subsystem=self._name,
            at_s=now_s,
            sim_s=clock.sim_s,
            late_ticks=clock.late_ticks,
            ticks=clock.ticks,
            arms=arms,
        )

    def _answer(self, question: Question) -> m.SimTruthReply | m.SimDone:
        request, note = question.request, ""
        match question:
            case m.SimTruth():
                return self._truth(request)
            case m.SimFactors():
                error = self._simulation.change_physics(question.mass, question.friction)
            case m.SimDisplace():
                error = self._displace(question.object, question.offset)
            case m.SimInject():
                error = self._faults.inject(question.fault)
            case m.SimUndo():
                error, note = self._faults.undo(question.fault)
        return m.SimDone(request=request, error=error, note=note, active=self._faults.active)

    def _displace(self, name: str, offset: list[float]) -> str:
        if len(offset) != 6 or not all(abs(part) <= FARTHEST for part in offset):
            return f"offset: six finite numbers are required, none beyond {FARTHEST:g} m or rad"
        return self._simulation.displace(name, offset)

    def _truth(self, request: str) -> m.SimTruthReply:
        truth = self._simulation.truth()
        return m.SimTruthReply(
            request=request,
            at_s=process.now_s(),
            sim_s=self._clock.sim_s,
            poses=truth["poses"],
            velocities=truth["velocities"],
            tcp=truth["tcp"],
            joints=truth["joints"],
            fingers=truth["fingers"],
            held=self._simulation.held(),
            seats=truth["seats"],
            blind=sorted(self._faults.blind),
            tight_nm={name: torque for name, (torque,) in truth.get("tight_nm", {}).items()},
        )


def _in_real_time(settings: Settings) -> bool:
    """Whether the process idles between its ticks. Faster than real time it would keep the core from others."""
    return 0.0 < settings.speed <= 1.0


def _raise_priority(settings: Settings) -> str:
    """Request real-time priority, because a servo tick is short and cannot wait; otherwise only a lower niceness."""
    if _in_real_time(settings):
        return process.raise_priority(RANK, NICENESS)
    if not process.nice(NICENESS):
        return "no permission for a higher priority"
    process.nice_session(NICENESS)
    return f"niceness {NICENESS}"


def main() -> None:
    arguments = argparse.ArgumentParser(prog="python -m sim_mcm", description=__doc__)
    arguments.add_argument("--run-dir", required=True, help="run directory of the cluster (has settings.json)")
    arguments.add_argument("--name", default=ARMS.name, help="its name as a subsystem of the cell")
    arguments.add_argument("--template", action="store_true", help="be the fork server of the MCM")
    handover.add_option(arguments)
    given = arguments.parse_args()
    time_limit.install()
    if given.template:
        simulation = _simulation(handover.load(Path(given.run_dir), given.handed).settings, given.name)
        fork_server.serve(lambda order: live(given.run_dir, given.name, given.handed, simulation))
    else:
        live(given.run_dir, given.name, given.handed)


def _simulation(settings: Settings, name: str) -> Simulation:
    """The cell with the arms of this subsystem."""
    return SIMULATIONS[settings.mcm](Cell.load(settings.cell).of_subsystem(name))


def live(run_dir: str, name: str, fd: int = -1, simulation: Simulation | None = None) -> None:
    """Run the MCM until it is stopped. `fd`: handover from the supervisor (rtc.runtime.handover); `simulation`: a
    prepared one in its initial state."""
    process.show_name(name)
    given = handover.claim_role(name, Path(run_dir), fd)
    settings = given.settings
    limit_data()
    with process.start(name, run_dir) as me:
        me.end_with_parent(END_S * settings.timeout_scale + LAST_S)
        if _in_real_time(settings):
            process.real_time_io(me.context, IO_RANK)
        station = SimulationLoop(me, name, given, simulation or _simulation(settings, name))
        me.log.info("scheduling: %s", _raise_priority(settings))
        station.run()


if __name__ == "__main__":
    main()

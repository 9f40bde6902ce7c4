"""The executor of one arm: accepts one primitive at a time, executes it, and ends it for exactly one reason.

    sample -> stop functions, in fixed priority -> reflex -> command every tick, from the current sample alone (R66)

The table in `modes` lists all state changes. The executor is pure: it has no clock and no socket. The caller passes
the time and sends the messages that `accept` and `tick` return. It knows neither the other arm nor objects; an arm
holds something if its fingers press.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import msgspec

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Reflex, StopReason
from rtc.subsystems.base.report_items import Measure, measured
from rtc.subsystems.motion import acceptance, profiles, stop_functions
from rtc.subsystems.motion.arm import TICK_S, ArmInterface, HandCommand, Motion, Sample
from rtc.subsystems.motion.bolts import SpindleTurn
from rtc.subsystems.motion.bounds import ConditionBounds
from rtc.subsystems.motion.clearance import Clearance
from rtc.subsystems.motion.coupler import Coupler
from rtc.subsystems.motion.goals import GOAL_RAD, Arrived, arrival
from rtc.subsystems.motion.hand import Hand
from rtc.subsystems.motion.jog import Jog
from rtc.subsystems.motion.modes import AFTER_STOP, COUNTING, MOVING, TRANSITIONS, Mode, Trigger
from rtc.subsystems.motion.moment import Finding
from rtc.subsystems.motion.observation import WINDOW_TICKS, Observation
from rtc.subsystems.motion.operation import OperatedArm
from rtc.subsystems.motion.reports import Trip, end_report, not_begun
from rtc.subsystems.motion.running_reports import RunningReports
from rtc.subsystems.motion.setpoints import Setpoints
from rtc.subsystems.motion.stray_watch import StrayWatch

# After these reasons the arm may lean on an obstacle, so it cannot reach the commanded position.
TOUCHED = frozenset(
    {
        StopReason.CONTACT,
        StopReason.FORCE_LIMIT,
        StopReason.TORQUE_LIMIT,
        StopReason.COLLISION,
        StopReason.ARM_CONTACT,
    }
)

SETTLE_LIMIT_S = 1.0  # maximum wait for measured rest; then the end is reported anyway
# An arm that rests for so long does not swing: one that bears a load stays beside its command. An arm that swings rests
# for a part of this, where it turns (measured values: docs/physics.md).
STILL_TICKS = 100
PRESSES_N = 3.0  # an arm that feels more than this since the start of its primitive leans on something
RELEASE_LIMIT_S = 3.0
# Reflex COMPLY: no spring, damping only. It ends at rest with a smaller force than this, or after this time.
LIMP = p.Compliance(stiffness=[0.0] * 6)
COMPLIED_N, COMPLY_LIMIT_S = 1.0, 3.0

Reports = Sequence[m.Started | m.PauseChanged | m.ProgressReport | m.EndReport | m.Strayed]
NOTHING: Reports = ()


class Executor:
    def __init__(self, arm: ArmInterface, measure: Measure = measured) -> None:
        self.name = arm.traits.name
        self._measure = measure  # of report items of packages
        self.state = Mode.HOLDING
        self.primitive: p.Primitive | None = None
        self.trip: Trip | None = None
        self._seen = Observation(arm)
        self._setpoints = Setpoints(arm.traits, self.sample.joints)
        self._hand = Hand(self._seen)
        self._stray = StrayWatch(self._seen, self._setpoints)
        self._ticks = 0  # since the start of this primitive
        self._paused_ticks = 0  # of them
        self._moved_ticks = 0  # of them, with a motion
        self._still_ticks = 0  # at rest, since it settles
        self._stands = False  # on its path, in a pause
        self._stops: stop_functions.Stops = []
        self._bounds = ConditionBounds([], arm.traits)
        self._arrived: Arrived = lambda time_s: None
        self._reports: RunningReports | None = None  # of the primitive
        self._watch = stop_functions.RetreatWatch([])
        self._spindle: SpindleTurn | None = None  # of the primitive, if it turns one
        self._coupler: Coupler | None = None  # of the primitive, if it locks a hand or lets go of one
        self.operated: OperatedArm | None = None  # while the operator moves the arm
        # The present control law complies: in EXECUTING, COMPLYING, and until rest if the primitive asks for it.
        self._compliant = False
        # Of the latest stop: the time along the trajectory, whether the arm was compliant; and whether the hand opens.
        self._stopped_at_s, self._was_compliant, self._releasing = 0.0, False, False
        self._work: dict[Mode, Callable[[float], Reports]] = {
            Mode.HOLDING: lambda now_s: NOTHING,
            Mode.EXECUTING: self._execute,
            Mode.STOPPING: self._stop,
            Mode.RETREATING: self._retreat,
            Mode.RELEASING: self._release,
            Mode.COMPLYING: self._comply,
            Mode.SETTLING: self._settle,
        }
        self._enter: dict[Mode, Callable[[], None]] = {
            Mode.HOLDING: self._begin_holding,
            Mode.EXECUTING: self._begin_executing,
            Mode.STOPPING: self._begin_stopping,
            Mode.RETREATING: self._begin_retreat,
            Mode.RELEASING: self._begin_release,
            Mode.COMPLYING: self._begin_comply,
            Mode.SETTLING: self._begin_settling,
        }

    # --- public interface ---------------------------------------------------------------------------

    @property
    def arm(self) -> ArmInterface:
        return self._seen.arm

    @arm.setter
    def arm(self, arm: ArmInterface) -> None:
        self._seen.arm = arm

    @property
    def sample(self) -> Sample:
        """The measurements of this tick."""
        return self._seen.sample

    @property
    def moving(self) -> bool:
        return self.state in MOVING

    @property
    def at_rest(self) -> bool:
        return self.state in (Mode.HOLDING, Mode.SETTLING) and self._seen.joints_rest()

    @property
    def primitive_id(self) -> str:
        return self.primitive.id if self.primitive else ""

    @property
    def wrench(self) -> list[float]:
        """Wrench of this tick (N, N.m) minus the bias of the current or last primitive."""
        return self._seen.wrench

    @property
    def hand(self) -> HandCommand:
        """The latest command of the hand."""
        return self._hand.command

    @property
    def command(self) -> Motion:
        """The latest command of the joints."""
        return self._setpoints.command

    def accept(self, primitive: p.Primitive, now_s: float) -> Reports:
        """Start it with the next tick or refuse it: returns `Started` or an end report with the reason REFUSED."""
        why = self._objection(primitive)
        if why:
            pose, hand = self._seen.tcp(), self.arm.traits.hand
            return [not_begun(primitive.id, self.name, why, at_s=now_s, sample=self.sample, tcp_pose=pose, hand=hand)]
        self.primitive = primitive
        self._apply(Trigger.ACCEPTED)
        return [m.Started(primitive=primitive.id, at_s=now_s)]

    @property
    def path_s(self) -> float:
        """Time along its trajectory that the present or latest primitive has reached (s); infinite at its goal."""
        return self._setpoints.time_s if self.state is Mode.EXECUTING else self._stopped_at_s

    def halt(self, reason: StopReason = StopReason.HALT, words: str = "") -> bool:
        """Brake with the next tick, in any state. Returns True if the arm was in motion. `reason`: of the end report,
        unless the primitive is ending already."""
        was_moving = self.moving
        if self.state is Mode.EXECUTING:
            self._trip(Trip(reason=reason, message=words), Trigger.HALTED)
        else:
            if self.trip is not None:  # keep the reason; cancel the rest of the reflex
                self.trip = msgspec.structs.replace(self.trip, reflex=Reflex.STOP)
            self._apply(Trigger.HALTED)
        return was_moving

    @property
    def strayed(self) -> str:
        """How the arm has moved without a primitive since its latest one; empty: it has not."""
        return self._stray.how

    @property
    def paused(self) -> bool:
        """Whether its primitive is to pause on its path, or does."""
        if self.operated is not None:
            return self.operated.paused
        return self.state is Mode.EXECUTING and self._setpoints.pace.paused

    @property
    def ramp_s(self) -> float:
        """The time that a pause, or its end, needs from now on."""
        setpoints = self._setpoints
        return setpoints.pace.next_ramp_s(setpoints.profile, setpoints.time_s, self._most_rad_s2)

    @property
    def held_back(self) -> bool:
        """Whether it stands on its path, or is to, because it may not go on yet."""
        return self.state is Mode.EXECUTING and self._setpoints.pace.held

    def keep_before(self, path_s: float) -> None:
        """Stand on the path before this time along it; call it in each tick, infinite: go on. Its time limit does not
        count meanwhile. Only for a path, and without effect on an arm that stops."""
        if self.state is Mode.EXECUTING:
            most = [min(a, profiles.STOP_ACCELERATION_RAD_S2) for a in self._most_rad_s2]  # a halt stops as soon
            self._setpoints.keep_before(path_s, most)

    def pace(self, paused: bool, ramp_s: float = 0.0) -> None:
        """Pause the primitive on its path, or let it go on, within this time or more. F is checked as before; its time
        limit does not count from the order to pause until the order to go on. Without effect on an arm that stops."""
        if self.state is not Mode.EXECUTING or paused is self.paused:
            return
        if self.operated is not None:
            self.operated.paused = paused
            return
        self._setpoints.order_pace(paused, ramp_s)
        assert self.primitive is not None
        trajectory = self.primitive.trajectory
        if isinstance(trajectory, p.HandMotion):
            if paused:
                self._hand.freeze()
            else:
                self._hand.move(trajectory)
        if self._spindle is not None:
            self._pace_spindle(self._spindle, paused)

    def _pace_spindle(self, spindle: SpindleTurn, paused: bool) -> None:
        if paused:
            spindle.stop()
            return
        try:
            spindle.run()
        except ValueError as error:  # the driver is not in the hand any more
            self._trip(Trip(reason=StopReason.OBJECT_LOST, message=str(error)), Trigger.TRIPPED)

    def tick(self, now_s: float) -> Reports:
        """One servo tick: read the sample, evaluate, command."""
        seen, setpoints = self._seen, self._setpoints
        n = setpoints.ticks + 1
        if n < setpoints.next_check_tick:  # in nearly every tick of a path; half the time of the whole tick below
            seen.sample = seen.arm.read()  # it does not enter the window; that saves 1 us
            seen.feel(True)
            if self._bounds.hold(seen, setpoints.command):
                self._ticks += 1
                self._moved_ticks += 1
                command = setpoints.skip(n)
                if self._compliant:
                    seen.arm.feel(seen.wrench)
                seen.arm.follow(command)
                return NOTHING
            setpoints.next_check_tick = 0
            seen.watch()
        else:
            seen.read()
            if self.primitive is None:  # HOLDING
                return NOTHING if self._stray.stands else self._stray.brake(self.name)
        return self._whole_tick(now_s)

    def _whole_tick(self, now_s: float) -> Reports:
        """Evaluate all stop functions in their order, and all that depends on time or state; then command."""
        seen, setpoints = self._seen, self._setpoints
        if self._ticks == 0:
            seen.begin()
        self._ticks += 1
        seen.feel(self.state in COUNTING)
        reports = self._work[self.state](now_s)
        command = setpoints.advance() if setpoints.pace.full else setpoints.advance_slowly(self._most_rad_s2)
        if not setpoints.allows(command):
            command = self._brake_instead(command)
        setpoints.command = command
        if any(command[1]) or (self._compliant and not seen.joints_rest()):
            self._moved_ticks += 1
        if (path := setpoints.new_block) is not None:
            self._look_ahead(path)
        if self._compliant:
            seen.arm.feel(seen.wrench)
        seen.arm.follow(command)
        return reports

    def _look_ahead(self, path: profiles.Follow) -> None:
        """Note for how many ticks of a new block only the sample can end the primitive or cause a report: neither its
        time limit, nor the end of the path, nor a periodic report is due."""
        setpoints, reports = self._setpoints, self._reports
        setpoints.look_ahead(path)
        if reports is None or reports.conditions or not (path.block_fits and self._bounds.exist):
            return
        ticks = (
            len(path.block) - 1 - path.latest,
            (path.duration_s - setpoints.time_s) / TICK_S - 1 - WINDOW_TICKS,  # rest is watched at its end
            (self._bounds.time_s - self._elapsed_s) / TICK_S - 1,
            reports.ticks_left(self._ticks) - 1,
        )
        count = int(min(ticks))
        if count > 0:
            setpoints.next_check_tick = setpoints.ticks + 1 + count
            self._seen.forget_window()

    # --- the states ------------------------------------------------------------------------------------

    def _begin_holding(self) -> None:
        trip = self.trip
        touched = trip is not None and trip.reason in (StopReason.COLLISION, StopReason.ARM_CONTACT)
        self._seen.forget_touches(trip.message if trip is not None and touched else None)
        if self._compliant and self.primitive is not None:
            self._stiffen(self.primitive.control_law)
            self._setpoints.stay()
        self.primitive = None
        self.operated = None
        self.trip = None
        self._setpoints.path = None
        self._seen.stands_at = self.sample.joints

    def _begin_executing(self) -> None:
        assert self.primitive is not None
        trajectory = self.primitive.trajectory
        self._stray.release()
        self._ticks = self._paused_ticks = self._moved_ticks = 0
        self._stands = self._releasing = False
        self._stopped_at_s, self._was_compliant = 0.0, False
        self._compliant = self.primitive.control_law.compliance is not None
        if isinstance(trajectory, p.JointTrajectory):
            self._setpoints.follow(trajectory)
        elif isinstance(trajectory, p.TeleopMotion):
            self._begin_operation(trajectory)
        else:
            self._setpoints.stay()
        if isinstance(trajectory, p.HandMotion):
            self._hand.move(trajectory)
        self._spindle = SpindleTurn(trajectory, self._seen) if isinstance(trajectory, p.SpindleMotion) else None
        if self._spindle is not None:
            self._spindle.run()
        self._coupler = Coupler(trajectory.hand, self._seen) if isinstance(trajectory, p.Coupling) else None
        if isinstance(trajectory, p.SpindleMotion) and trajectory.retreat is not None:
            self._setpoints.keep(trajectory.retreat)
        duration_s, within_m = self._setpoints.profile.duration_s, self.primitive.goal_within_m
        self._arrived = arrival(trajectory, self._seen, duration_s, self._turned_rad, within_m)

    def _begin_operation(self, trajectory: p.TeleopMotion) -> None:
        """Let the operator move the arm, from where it is."""
        operated = self.operated = OperatedArm(trajectory, self._seen, self._hand)
        arm, laden = self.arm, self._hand.grips
        still = self.command[0]
        most_m_s = trajectory.speed_m_s if trajectory.along is None else math.inf  # the program has speeds of its own
        wanted = lambda: operated.twist(self._seen.tcp())  # noqa: E731
        shared = trajectory.along is not None  # a path slides along nothing: it waits
        jog = Jog(still, arm.traits, arm.jacobian, wanted, laden=laden, most_m_s=most_m_s, shared=shared)
        for stop, check in self._stops:
            if isinstance(check, Clearance) and (stop.reason, stop.reflex) == (StopReason.OUT_OF_RANGE, Reflex.STOP):
                jog.guides.append(check.guide(arm.jacobian))
        operated.cut_by_arm = lambda: jog.cut
        self._setpoints.use(jog)

    def operate(self, wanted: m.Operate, caller: bytes, now_s: float) -> str:
        """Follow the hand of the operator. Returns why it does nothing; empty: it counts."""
        if self.operated is None or wanted.primitive != self.primitive_id:
            return f"{wanted.primitive} is not what {self.name} executes now: its grant has ended"
        return self.operated.objection(wanted, caller, now_s)

    def answer(self, answer: m.OperatorAnswer) -> str:
        """End what the operator does with DONE or CANNOT. Returns why a DONE is refused; empty: it is accepted."""
        assert self.operated is not None
        if not answer.done:
            self.halt(StopReason.OPERATOR_CANNOT, answer.why)
            return ""
        why = self.operated.why_not_done()
        self.operated.done = not why
        return why

    def _turned_rad(self) -> float:
        return 0.0 if self._spindle is None else self._spindle.turned_rad

    def _execute(self, now_s: float) -> Reports:
        seen, bounds, elapsed_s = self._seen, self._bounds, self._elapsed_s
        setpoints, running = self._setpoints, self._reports
        assert running is not None
        if self.operated is not None:
            self.operated.follow(now_s)
        if self._coupler is not None and self._coupler.works(setpoints.time_s):
            self._hand = Hand(seen)
            if self._coupler.why_not:
                self._trip(Trip(reason=StopReason.NO_CONTACT, message=self._coupler.why_not), Trigger.TRIPPED)
                return self._stop(now_s)
        arrived = self._arrived(setpoints.time_s) if self.operated is None else self._arrived_by_hand()
        reports, found = NOTHING, None
        in_time = arrived is None and elapsed_s <= bounds.time_s
        if running.conditions or not (in_time and bounds.hold(seen, setpoints.command)):
            moment = seen.moment(elapsed_s, arrived, setpoints.command)
            reports = running.conditions_met(moment, now_s)
            found = stop_functions.first(self._stops, moment)
        if found is None and (fault := seen.arm.fault()):
            self._trip(Trip(reason=StopReason.FOLLOWING_ERROR, message=fault), Trigger.TRIPPED)
            return [*reports, *self._stop(now_s)]
        if found is not None:
            stop, (measured, limit, words) = found
            trip = Trip(
                reason=stop.reason,
                reflex=stop.reflex,
                back_off_m=stop.back_off_m,
                measured=measured,
                limit=limit,
                message=words,
            )
            self._trip(trip, Trigger.TRIPPED)
            return [*reports, *self._stop(now_s)]
        if self.paused or self._stands or setpoints.pace.held:
            reports = [*reports, *self._paced(now_s)]
        if running.period is not None and self._ticks % running.period == 0:
            reports = [*reports, running.progress(now_s)]
        return reports

    def _paced(self, now_s: float) -> Reports:
        """Count a tick of a pause, and report when the arm stands on its path or goes on."""
        pace = self._setpoints.pace
        self._paused_ticks += self.paused or pace.held
        stands = self.paused and (pace.rate == 0.0 if self.operated is None else self._seen.joints_rest())
        if stands is self._stands:
            return []
        self._stands = stands
        return [m.PauseChanged(primitive=self.primitive_id, at_s=now_s, paused=stands, done=self._done())]

    def _arrived_by_hand(self) -> Finding | None:
        assert self.operated is not None
        return (None, None, "") if self.operated.done else None

    def _done(self) -> float:
        """Share of the path, or of the turn of the spindle."""
        if self.operated is not None:
            return 0.0
        if self._spindle is not None:
            return self._spindle.done
        duration_s = self._setpoints.profile.duration_s
        return min(1.0, self._setpoints.time_s / duration_s) if duration_s else 0.0

    def _begin_stopping(self) -> None:
        assert self.primitive is not None
        assert self.trip is not None
        self._was_compliant = self._compliant
        self._stopped_at_s = math.inf if self.trip.reason is StopReason.GOAL else self._setpoints.time_s
        if self._spindle is not None:
            self._spindle.stop()
        if self.operated is not None:
            self.operated.stop()
        compliance = self.primitive.control_law.compliance
        if self._compliant and not (compliance is not None and compliance.until_rest):
            self._stiffen(self.primitive.control_law)
        self._setpoints.use(profiles.Brake(self.command, laden=self._hand.grips))
        trajectory = self.primitive.trajectory
        by_hand = isinstance(trajectory, p.TeleopMotion) and trajectory.hand
        complete = self.trip.reason in (StopReason.GOAL, StopReason.OPERATOR_DONE)
        hand_moves = (isinstance(trajectory, p.HandMotion) or by_hand) and not complete
        if hand_moves or self._releasing:
            self._hand.freeze()

    def _stop(self, now_s: float) -> Reports:
        if not self._setpoints.over:
            return []
        assert self.trip is not None
        following = AFTER_STOP[self.trip.reflex]
        self._apply(Trigger.DONE, following)
        return self._work[following](now_s)

    def _begin_retreat(self) -> None:
        assert self.trip is not None
        self._watch = stop_functions.RetreatWatch(self._stops)
        joints, path = self.command[0], self._setpoints.path
        if path is None or self.trip.back_off_m <= 0.0:
            self._setpoints.stay()  # no path to retrace
            return
        tripped_s = self.trip.at_path_s
        if self._spindle is not None:  # its bolt moves it along this line, in its own time
            tripped_s = path.nearest_s(joints, path.duration_s)
        elif self._was_compliant:  # the arm may be far behind its command
            tripped_s = path.nearest_s(joints, tripped_s)
        self._setpoints.use(profiles.Retrace(path, tripped_s, joints, self.trip.back_off_m, self.arm.tcp_pose))

    def _retreat(self, now_s: float) -> Reports:
        met = self._watch.first(self._seen.moment(self._elapsed_s, None, self.command))
        if met is not None:
            self._cut_retreat(*met)
            return self._stop(now_s)
        if not self._setpoints.over:
            return []
        self._apply(Trigger.DONE)
        return self._settle(now_s)

    def _cut_retreat(self, reason: StopReason, finding: Finding) -> None:
        """Stop the retreat. The reason of the primitive stays; its message gets the obstacle."""
        assert self.trip is not None
        measured, limit, words = finding
        figures = "" if measured is None or limit is None else f"{measured:.3g} where {limit:.3g} is the limit"
        what = f"backing off was stopped: {reason.value}, {words or figures}"
        message = "; ".join(filter(None, (self.trip.message, what)))
        self.trip = msgspec.structs.replace(self.trip, reflex=Reflex.STOP, message=message)
        self._apply(Trigger.TRIPPED)

    def _begin_release(self) -> None:
        self._releasing = True
        self._setpoints.stay()
        self._hand.open()

    def _release(self, now_s: float) -> Reports:
        if not self._hand.is_open and self._setpoints.time_s < RELEASE_LIMIT_S:
            return []
        self._apply(Trigger.DONE)
        return self._settle(now_s)

    def _begin_comply(self) -> None:
        assert self.primitive is not None
        self._setpoints.stay()
        self.arm.use_law(_limp(self.primitive.control_law))
        self._compliant = True

    def _comply(self, now_s: float) -> Reports:
        rests = self._seen.joints_rest() and self._seen.force_n < COMPLIED_N
        waited_s = self._setpoints.time_s
        if waited_s < WINDOW_TICKS * TICK_S or (not rests and waited_s < COMPLY_LIMIT_S):
            return []
        assert self.primitive is not None
        self._stiffen(self.primitive.control_law)
        self._apply(Trigger.DONE)
        return self._settle(now_s)

    def _begin_settling(self) -> None:
        self._setpoints.stay()
        self._still_ticks = 0

    def _settle(self, now_s: float) -> Reports:
        """Wait for rest. An arm that leans then gives way: its command goes to where it is, and it presses no more."""
        setpoints = self._setpoints
        if isinstance(setpoints.profile, profiles.Unload):
            rests = self._seen.joints_rest() and self._seen.fingers_rest()
            if not (rests or setpoints.over) or not setpoints.profile.done(setpoints.time_s):
                return []
        elif not self._still() and setpoints.time_s < SETTLE_LIMIT_S:
            return []
        elif not self._compliant and (self._leans() or self._off_command() > GOAL_RAD):
            setpoints.use(profiles.Unload(setpoints.command, lambda: self.sample.joints))
            return []
        report = self._end_report(now_s)
        self._apply(Trigger.DONE)
        return [report]

    def _still(self) -> bool:
        """At rest and at the commanded position, or at rest beside it for as long as no swing is: an arm that swings
        with a load is at rest where it turns, and there it is not at the commanded position. An arm that bears the load
        of a door or a seat, or leans on an obstacle, does not reach that position."""
        rests = self._seen.joints_rest() and self._seen.fingers_rest()
        self._still_ticks = self._still_ticks + 1 if rests else 0
        there = self._leans() or self._off_command() < GOAL_RAD or self._still_ticks >= STILL_TICKS
        return rests and there

    def _leans(self) -> bool:
        assert self.trip is not None
        presses = self.trip.reason is not StopReason.GOAL and self._seen.force_n > PRESSES_N
        return presses or self._compliant or self.trip.reason in TOUCHED

    def _off_command(self) -> float:
        """The greatest joint error (rad)."""
        return self._seen.off(self.command[0])

    # --- internals -------------------------------------------------------------------------------------

    def _apply(self, event: Trigger, following: Mode | None = None) -> None:
        """Change the state. Nothing else does."""
        row = TRANSITIONS[self.state]
        assert event in row, f"{self.name}: {event.value} cannot happen while {self.state.value} ({self.primitive_id})"
        before, self.state = self.state, following or row[event]
        if self.state is not before or event is not Trigger.HALTED:
            self._enter[self.state]()

    def _trip(self, trip: Trip, event: Trigger) -> None:
        assert self.trip is None, "a primitive ends for one reason"
        pose = self._seen.tcp().tolist()
        wrench = self._seen.wrench
        self.trip = msgspec.structs.replace(trip, at_path_s=self._setpoints.time_s, pose=pose, wrench=wrench)
        self._apply(event)

    def _objection(self, primitive: p.Primitive) -> str:
        if self.primitive is not None:
            return f"{self.name} is busy with {self.primitive.id} ({self.state.value})"
        try:
            why = acceptance.objection(primitive, self.arm.traits, self.sample.joints)
            if why:
                return why
            stops = stop_functions.compile_stops(primitive, self.arm.traits)
            conditions = stop_functions.compile_reports(primitive, self.arm.traits)
            if any(stop.reflex is Reflex.COMPLY for stop in primitive.stop_functions):
                self.arm.use_law(_limp(primitive.control_law))  # an arm that cannot comply refuses here
            if isinstance(primitive.trajectory, p.SpindleMotion):
                spindle = SpindleTurn(primitive.trajectory, self._seen)
                spindle.run()  # an arm that cannot refuses here
                spindle.stop()
            self.arm.use_law(primitive.control_law)
        except ValueError as error:
            return str(error)
        except Exception as error:  # a bad primitive must not end the process that controls the other arm
            return f"it cannot be checked: {type(error).__name__}: {error}"
        self._stops, self._bounds = stops, ConditionBounds(stops, self.arm.traits)
        self._reports = RunningReports(self.name, self._seen, primitive, conditions, self._measure)
        return ""

    def _brake_instead(self, refused: Motion) -> Motion:
        """Brake from the last command within limits. Returns the command of this tick."""
        setpoints = self._setpoints
        if self.state is Mode.EXECUTING:
            k, speed = setpoints.fastest(refused)
            words = f"{self.arm.traits.joint_names[k]} was commanded to turn at {speed:.4g} rad/s"
            limit = setpoints.most_rad_s[k]
            trip = Trip(reason=StopReason.COMMAND_LIMIT, measured=speed, limit=limit, message=words)
            self._trip(trip, Trigger.TRIPPED)
            return setpoints.replace(setpoints.profile)
        return setpoints.replace(profiles.Brake(setpoints.command))  # keep the reason

    @property
    def _most_rad_s2(self) -> list[float]:
        most = self.arm.traits.acceleration
        if self._hand.grips:
            return [min(a, profiles.LADEN_ACCELERATION_RAD_S2) for a in most]
        return most

    def _stiffen(self, law: p.ControlLaw) -> None:
        """Change from a compliant law to position control, from the measured motion: so the arm stops as quickly as any
        other, presses with nothing, and does not jump to where its spring would have pulled it."""
        still = [0.0] * len(self.sample.joints)
        self._setpoints.command = (list(self.sample.joints), list(self.sample.velocities), still)
        self._compliant = False
        self.arm.use_law(p.ControlLaw(gains=law.gains, load=law.load))

    @property
    def _elapsed_s(self) -> float:
        """Since the start of the primitive, without its pauses."""
        return (self._ticks - self._paused_ticks) * TICK_S

    def _end_report(self, now_s: float) -> m.EndReport:
        assert self.trip is not None
        assert self.primitive is not None
        return end_report(
            self.primitive_id,
            self.name,
            self.trip,
            at_s=now_s,
            duration_s=self._ticks * TICK_S,
            paused_s=self._paused_ticks * TICK_S,
            moved_s=self._moved_ticks * TICK_S,
            seen=self._seen,
            items=self.primitive.reporting.items,
            measure=self._measure,
            turned_rad=self._turned_in_all(),
        )

    def _turned_in_all(self) -> float | None:
        """What the spindle has turned in this primitive (rad); None: it is not about one."""
        assert self.primitive is not None
        if self.operated is not None:
            trajectory = self.primitive.trajectory
            return self.operated.turned_rad if isinstance(trajectory, p.TeleopMotion) and trajectory.spindle else None
        return None if self._spindle is None else self._spindle.turned_rad


def _limp(law: p.ControlLaw) -> p.ControlLaw:
    """The law of the reflex COMPLY, with the load of the primitive."""
    return p.ControlLaw(name="impedance", gains=law.gains, load=law.load, compliance=LIMP)

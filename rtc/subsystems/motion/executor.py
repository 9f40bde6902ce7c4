"""The executor of one arm: accepts one primitive at a time, executes it, and ends it for exactly one reason.

    sample -> stop functions, in fixed priority -> reflex -> command every tick, from the current sample alone (R66)

The table in `modes` lists all state changes. The executor is pure: it has no clock and no socket. The caller passes
the time and sends the messages that `accept` and `tick` return. It knows neither the other arm nor objects; an arm
holds something if its fingers press.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Reflex, StopReason
from rtc.spatial.geometry import Array
from rtc.subsystems.base.report_items import STANDARD, reading
from rtc.subsystems.motion import acceptance, profiles, stop_functions
from rtc.subsystems.motion.arm import TICK_S, ArmInterface, HandCommand, Motion, Sample
from rtc.subsystems.motion.bounds import Bounds
from rtc.subsystems.motion.goals import GOAL_RAD, WIDTH_M, Arrived, arrival
from rtc.subsystems.motion.modes import AFTER_STOP, COUNTING, MOVING, TRANSITIONS, Mode, Trigger
from rtc.subsystems.motion.observation import WINDOW_TICKS, Observation
from rtc.subsystems.motion.pace import PathRate
from rtc.subsystems.motion.reports import Trip, end_report, not_begun
from rtc.subsystems.motion.spindle import SpindleTurn

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

# Factor by which a command may exceed a joint's speed limit. Reasons: an offset at the start of a path (0.08 rad/s);
# braking from an acceleration (0.14 rad/s). A greater excess is an error in the profile.
COMMAND_SLACK = 1.25
SQUEEZE_N = 1.0  # a smaller finger force does not count as a grip
SETTLE_LIMIT_S = 1.0  # maximum wait for measured rest; then the end is reported anyway
PRESSES_N = 3.0  # an arm that feels more than this since the start of its primitive leans on something
RELEASE_LIMIT_S = 3.0
# An arm without a primitive has moved by itself, or was moved, if its joints are farther than this from where they came
# to rest (norm; rad, m). A new path must begin within the same distance of it.
STRAYED = 0.01
# Reflex COMPLY: no spring, damping only. It ends at rest with a smaller force than this, or after this time.
LIMP = p.Compliance(stiffness=[0.0] * 6)
COMPLIED_N, COMPLY_LIMIT_S = 1.0, 3.0

Reports = Sequence[m.Started | m.PauseChanged | m.ProgressReport | m.EndReport | m.Strayed]
NOTHING: Reports = ()


@dataclass(slots=True)
class MotionProgress:
    """What has happened to the present or latest primitive, beyond its state; and since then.

    These are not attributes of the executor, because Python 3.11 finds attributes of an object with more than 30 of
    them in a hash table: that took 1.5 us of each tick.
    """

    stands: bool = False  # on its path, in a pause
    paused_ticks: int = 0
    stopped_at_s: float = 0.0  # time along the trajectory, of the latest stop
    was_compliant: bool = False  # up to the stop
    releasing: bool = False
    strayed: str = ""  # how the arm has moved since then, without a primitive; it is braked
    strayed_from: list[float] | None = None  # until it rests


class Executor:
    def __init__(self, arm: ArmInterface) -> None:
        self.name = arm.traits.name
        self.state = Mode.HOLDING
        self.primitive: p.Primitive | None = None
        self.trip: Trip | None = None
        self._seen = Observation(arm)
        self._most_rad_s = [COMMAND_SLACK * limit for limit in arm.traits.velocity]
        self._most_step_rad = [limit * TICK_S for limit in self._most_rad_s]
        self._ticks = 0  # since the start of this primitive
        self._profile: profiles.Profile = profiles.Stay(self.sample.joints)
        self._profile_ticks = 0
        self._shift_s = 0.0  # time of the profile minus that of its ticks: what passed at another rate
        self._pace = PathRate()
        self._command: Motion = self._profile.at(0.0)
        self._follow: profiles.Follow | None = None  # the path, if the primitive has one
        # Its present motions, the tick of the profile of the first, and the tick that needs a whole tick again.
        self._block: Array = np.empty((0, 3, 0))
        self._block_from = self._next_check_tick = 0
        self._hand = HandCommand(self._seen.width_m, arm.traits.max_grip_n, arm.traits.hand_speed_m_s)
        self._stops: stop_functions.Stops = []
        self._bounds = Bounds([], arm.traits)
        self._arrived: Arrived = lambda time_s: None
        self._report_every: int | None = None
        self._report_when: stop_functions.Reports = []  # not reported yet
        self._watch = stop_functions.RetreatWatch([])
        self._motion = MotionProgress()
        self._spindle: SpindleTurn | None = None  # of the primitive, if it turns one
        # The present control law complies: in EXECUTING, COMPLYING, and until rest if the primitive asks for it.
        self._compliant = False
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
        return self._hand

    def accept(self, primitive: p.Primitive, now_s: float) -> Reports:
        """Start it with the next tick or refuse it: returns `Started` or an end report with the reason REFUSED."""
        why = self._objection(primitive)
        if why:
            pose = self._seen.tcp()
            return [not_begun(primitive.id, self.name, why, at_s=now_s, sample=self.sample, tcp_pose=pose)]
        self.primitive = primitive
        self._apply(Trigger.ACCEPTED)
        return [m.Started(primitive=primitive.id, at_s=now_s)]

    @property
    def path_s(self) -> float:
        """Time along its trajectory that the present or latest primitive has reached (s); infinite at its goal."""
        return self._profile_time_s if self.state is Mode.EXECUTING else self._motion.stopped_at_s

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
        return self._motion.strayed

    @property
    def paused(self) -> bool:
        """Whether its primitive is to pause on its path, or does."""
        return self.state is Mode.EXECUTING and self._pace.paused

    @property
    def ramp_s(self) -> float:
        """The time that a pause, or its end, needs from now on."""
        return self._pace.next_ramp_s(self._profile, self._profile_time_s, self._most_rad_s2)

    def pace(self, paused: bool, ramp_s: float = 0.0) -> None:
        """Pause the primitive on its path, or let it go on, within this time or more. F is checked as before; its time
        limit does not count from the order to pause until the order to go on. Without effect on an arm that stops."""
        if self.state is not Mode.EXECUTING or paused is self._pace.paused:
            return
        self._pace.order(paused, ramp_s)
        self._next_check_tick = 0
        assert self.primitive is not None
        trajectory = self.primitive.trajectory
        if isinstance(trajectory, p.HandMotion):
            if paused:
                self._freeze_hand()
            else:
                self._move_hand(trajectory)
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
        seen = self._seen
        n = self._profile_ticks + 1
        if n < self._next_check_tick:  # in nearly every tick of a path; half the time of the whole tick below
            seen.sample = seen.arm.read()  # it does not enter the window; that saves 1 us
            seen.feel(True)
            if self._bounds.hold(seen, self._command):
                self._ticks += 1
                self._profile_ticks = n
                # Lists made as late as this stay in the nearest cache: 2 us less than with lists of the whole block.
                self._command = command = self._block[n - self._block_from].tolist()
                if self._compliant:
                    seen.arm.feel(seen.wrench)
                seen.arm.follow(command)
                return NOTHING
            self._next_check_tick = 0
            seen.watch()
        else:
            seen.read()
            if self.primitive is None:  # HOLDING
                if math.dist(seen.sample.joints, seen.stands_at) <= STRAYED:  # in nearly every tick
                    return NOTHING
                return self._stray()
        return self._whole_tick(now_s)

    def _whole_tick(self, now_s: float) -> Reports:
        """Evaluate all stop functions in their order, and all that depends on time or state; then command."""
        seen = self._seen
        if self._ticks == 0:
            seen.begin()
        self._ticks += 1
        seen.feel(self.state in COUNTING)
        reports = self._work[self.state](now_s)
        if self._pace.full:
            self._profile_ticks += 1
            command = self._profile.at(self._profile_ticks * TICK_S + self._shift_s)
        else:
            command = self._advance_slowly()
        if not self._checked and not self._within_limits(command):
            command = self._brake_instead(command)
        self._command = command
        if self._profile is self._follow and self._pace.full and self._follow.block is not self._block:
            self._look_ahead(self._follow)
        if self._compliant:
            seen.arm.feel(seen.wrench)
        seen.arm.follow(command)
        return reports

    def _look_ahead(self, follow: profiles.Follow) -> None:
        """Note for how many ticks of a new block only the sample can end the primitive or cause a report: neither its
        time limit, nor the end of the path, nor a periodic report is due."""
        self._block, self._block_from, self._next_check_tick = follow.block, self._profile_ticks - follow.latest, 0
        if self._report_when or not (follow.block_fits and self._bounds.exist):
            return
        ticks = [
            len(follow.block) - 1 - follow.latest,
            (follow.duration_s - self._profile_time_s) / TICK_S - 1 - WINDOW_TICKS,  # rest is watched at its end
            (self._bounds.time_s - self._elapsed_s) / TICK_S - 1,
        ]
        if self._report_every is not None:
            ticks.append(self._report_every - 1 - self._ticks % self._report_every)
        count = int(min(ticks))
        if count > 0:
            self._next_check_tick = self._profile_ticks + 1 + count
            self._seen.forget_window()

    def _stray(self) -> Reports:
        """Brake an arm that moves without a primitive. A report when it begins, another when the arm rests."""
        seen, course = self._seen, self._motion
        if course.strayed_from is None:
            course.strayed_from = seen.stands_at
            self.arm.brake(True)
        elif not seen.joints_rest():
            return NOTHING
        joint, off = seen.farthest(course.strayed_from)
        far = f"{1e3 * off:.0f} mm" if self.arm.traits.margins(1.0)[joint] < 1.0 else f"{math.degrees(off):.1f} deg"
        rests = "it rests" if seen.joints_rest() else "it moves"
        course.strayed = f"moved without a command, {self.arm.traits.joint_names[joint]} by {far}; braked, {rests}"
        if seen.joints_rest():
            course.strayed_from = None
            self._stand()
        return [m.Strayed(arms={self.name: course.strayed})]

    def _stand(self) -> None:
        """Command the arm to stay where it is."""
        self._seen.stands_at = self.sample.joints
        self._use(profiles.Stay(self.sample.joints))
        self._command = self._profile.at(0.0)
        self.arm.follow(self._command)

    # --- the states ------------------------------------------------------------------------------------

    def _begin_holding(self) -> None:
        trip = self.trip
        touched = trip is not None and trip.reason in (StopReason.COLLISION, StopReason.ARM_CONTACT)
        self._seen.forget_touches(trip.message if trip is not None and touched else None)
        if self._compliant and self.primitive is not None:
            self._stiffen(self.primitive.control_law)
            self._use(profiles.Stay(self._command[0]))
        self.primitive = None
        self.trip = None
        self._follow = None
        self._seen.stands_at = self.sample.joints

    def _begin_executing(self) -> None:
        assert self.primitive is not None
        trajectory = self.primitive.trajectory
        if self._motion.strayed:
            self.arm.brake(False)
        self._ticks, self._motion = 0, MotionProgress()
        self._compliant = self.primitive.control_law.compliance is not None
        every_s = self.primitive.reporting.every_s
        self._report_every = None if every_s is None else max(1, round(every_s / TICK_S))
        joints = self._command[0]
        if isinstance(trajectory, p.JointTrajectory):
            self._follow = profiles.Follow(trajectory, joints, self._most_rad_s)
            self._use(self._follow)
        else:
            self._use(profiles.Stay(joints))
        if isinstance(trajectory, p.HandMotion):
            self._move_hand(trajectory)
        self._spindle = SpindleTurn(trajectory, self._seen) if isinstance(trajectory, p.SpindleMotion) else None
        if self._spindle is not None:
            self._spindle.run()
        self._arrived = arrival(trajectory, self._seen, self._profile.duration_s, self._turned_rad)

    def _turned_rad(self) -> float:
        return 0.0 if self._spindle is None else self._spindle.turned_rad

    def _execute(self, now_s: float) -> Reports:
        seen, bounds, elapsed_s = self._seen, self._bounds, self._elapsed_s
        arrived = self._arrived(self._profile_time_s)
        reports, found = NOTHING, None
        in_time = arrived is None and elapsed_s <= bounds.time_s
        if self._report_when or not (in_time and bounds.hold(seen, self._command)):
            moment = seen.moment(elapsed_s, arrived, self._command)
            reports = self._conditions_met(moment, now_s)
            found = stop_functions.first(self._stops, moment)
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
        if self._pace.paused or self._motion.stands:
            reports = [*reports, *self._paced(now_s)]
        if self._report_every is not None and self._ticks % self._report_every == 0:
            reports = [*reports, self._progress(now_s)]
        return reports

    def _conditions_met(self, moment: stop_functions.Moment, now_s: float) -> Reports:
        """A report for each condition of R that is true for the first time."""
        met: dict[int, m.ProgressReport] = {}
        for n, check in self._report_when:
            if (finding := check(moment)) is not None and n not in met:
                measured, limit, _ = finding
                progress = self._progress(now_s)
                met[n] = msgspec.structs.replace(progress, condition=n, measured=measured, limit=limit)
        if met:
            self._report_when = [(n, check) for n, check in self._report_when if n not in met]
        return list(met.values())

    def _paced(self, now_s: float) -> Reports:
        """Count a tick of a pause, and report when the arm stands on its path or goes on."""
        self._motion.paused_ticks += self._pace.paused
        stands = self._pace.rate == 0.0
        if stands is self._motion.stands:
            return []
        self._motion.stands = stands
        return [m.PauseChanged(primitive=self.primitive_id, at_s=now_s, paused=stands, done=self._done())]

    def _done(self) -> float:
        """Share of the path, or of the turn of the spindle."""
        if self._spindle is not None:
            return self._spindle.done
        return min(1.0, self._profile_time_s / self._profile.duration_s) if self._profile.duration_s else 0.0

    def _begin_stopping(self) -> None:
        assert self.primitive is not None
        assert self.trip is not None
        self._motion.was_compliant = self._compliant
        self._motion.stopped_at_s = math.inf if self.trip.reason is StopReason.GOAL else self._profile_time_s
        if self._spindle is not None:
            self._spindle.stop()
        compliance = self.primitive.control_law.compliance
        if self._compliant and not (compliance is not None and compliance.until_rest):
            self._stiffen(self.primitive.control_law)
        self._use(profiles.Brake(self._command, laden=self._seen.grip_n > SQUEEZE_N))
        hand_moves = isinstance(self.primitive.trajectory, p.HandMotion) and self.trip.reason is not StopReason.GOAL
        if hand_moves or self._motion.releasing:
            self._freeze_hand()

    def _stop(self, now_s: float) -> Reports:
        if self._profile_time_s < self._profile.duration_s:
            return []
        assert self.trip is not None
        following = AFTER_STOP[self.trip.reflex]
        self._apply(Trigger.DONE, following)
        return self._work[following](now_s)

    def _begin_retreat(self) -> None:
        assert self.trip is not None
        self._watch = stop_functions.RetreatWatch(self._stops)
        joints = self._command[0]
        if self._follow is None or self.trip.back_off_m <= 0.0:
            self._use(profiles.Stay(joints))  # no path to retrace
            return
        tripped_s = self.trip.at_path_s
        if self._motion.was_compliant:  # the arm may be far behind its command
            tripped_s = self._follow.nearest_s(joints, tripped_s)
        self._use(profiles.Retrace(self._follow, tripped_s, joints, self.trip.back_off_m, self.arm.tcp_pose))

    def _retreat(self, now_s: float) -> Reports:
        met = self._watch.first(self._seen.moment(self._elapsed_s, None, self._command))
        if met is not None:
            self._cut_retreat(*met)
            return self._stop(now_s)
        if self._profile_time_s < self._profile.duration_s:
            return []
        self._apply(Trigger.DONE)
        return self._settle(now_s)

    def _cut_retreat(self, reason: StopReason, finding: stop_functions.Finding) -> None:
        """Stop the retreat. The reason of the primitive stays; its message gets the obstacle."""
        assert self.trip is not None
        measured, limit, words = finding
        figures = "" if measured is None or limit is None else f"{measured:.3g} where {limit:.3g} is the limit"
        what = f"backing off was stopped: {reason.value}, {words or figures}"
        message = "; ".join(filter(None, (self.trip.message, what)))
        self.trip = msgspec.structs.replace(self.trip, reflex=Reflex.STOP, message=message)
        self._apply(Trigger.TRIPPED)

    def _begin_release(self) -> None:
        self._motion.releasing = True
        self._use(profiles.Stay(self._command[0]))
        traits = self.arm.traits
        self._use_hand(HandCommand(traits.max_opening_m, traits.max_grip_n, traits.hand_speed_m_s))

    def _release(self, now_s: float) -> Reports:
        opened = self._seen.width_m >= self.arm.traits.max_opening_m - WIDTH_M
        if not opened and self._profile_time_s < RELEASE_LIMIT_S:
            return []
        self._apply(Trigger.DONE)
        return self._settle(now_s)

    def _begin_comply(self) -> None:
        assert self.primitive is not None
        self._use(profiles.Stay(self._command[0]))
        self.arm.use_law(_limp(self.primitive.control_law))
        self._compliant = True

    def _comply(self, now_s: float) -> Reports:
        rests = self._seen.joints_rest() and self._seen.force_n < COMPLIED_N
        waited_s = self._profile_time_s
        if waited_s < WINDOW_TICKS * TICK_S or (not rests and waited_s < COMPLY_LIMIT_S):
            return []
        assert self.primitive is not None
        self._stiffen(self.primitive.control_law)
        self._apply(Trigger.DONE)
        return self._settle(now_s)

    def _begin_settling(self) -> None:
        self._use(profiles.Stay(self._command[0]))

    def _settle(self, now_s: float) -> Reports:
        """Wait for rest. An arm that leans then gives way: its command goes to where it is, and it presses no more."""
        if isinstance(self._profile, profiles.Unload):
            rests = self._seen.joints_rest() and self._seen.fingers_rest()
            if not (rests or self._profile_time_s >= self._profile.duration_s):
                return []
            if not self._profile.done(self._profile_time_s):
                return []
        elif not self._still() and self._profile_time_s < SETTLE_LIMIT_S:
            return []
        elif not self._compliant and (self._leans() or self._off_command() > GOAL_RAD):
            self._use(profiles.Unload(self._command, lambda: self.sample.joints))
            return []
        report = self._end_report(now_s)
        self._apply(Trigger.DONE)
        return [report]

    def _still(self) -> bool:
        """At rest and at the commanded position: an arm that swings with a load satisfies only one at a time. An arm
        that leans on an obstacle cannot reach the commanded position."""
        rests = self._seen.joints_rest() and self._seen.fingers_rest()
        return rests and (self._leans() or self._off_command() < GOAL_RAD)

    def _leans(self) -> bool:
        assert self.trip is not None
        presses = self.trip.reason is not StopReason.GOAL and self._seen.force_n > PRESSES_N
        return presses or self._compliant or self.trip.reason in TOUCHED

    def _off_command(self) -> float:
        """The greatest joint error (rad)."""
        return self._seen.off(self._command[0])

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
        self.trip = msgspec.structs.replace(trip, at_path_s=self._profile_time_s, pose=pose, wrench=wrench)
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
        self._stops, self._report_when = stops, conditions
        self._bounds = Bounds(stops, self.arm.traits)
        return ""

    def _within_limits(self, command: Motion) -> bool:
        """Whether every joint can reach the commanded position and speed within one tick."""
        joints, speeds, _ = command
        for q, before, most, speed, fastest in zip(
            joints, self._command[0], self._most_step_rad, speeds, self._most_rad_s, strict=True
        ):
            if not (-most <= q - before <= most and -fastest <= speed <= fastest):  # false for NaN too
                return False
        return True

    def _brake_instead(self, refused: Motion) -> Motion:
        """Brake from the last command within limits. Returns the command of this tick."""
        if self.state is Mode.EXECUTING:
            far = [abs(q - before) / TICK_S for q, before in zip(refused[0], self._command[0], strict=True)]
            k = max(range(len(far)), key=lambda n: far[n] / self._most_rad_s[n])
            words = f"{self.arm.traits.joint_names[k]} was commanded to turn at {far[k]:.4g} rad/s"
            limit = self._most_rad_s[k]
            trip = Trip(reason=StopReason.COMMAND_LIMIT, measured=far[k], limit=limit, message=words)
            self._trip(trip, Trigger.TRIPPED)
        else:  # keep the reason
            self._use(profiles.Brake(self._command))
        self._profile_ticks = 1
        return self._profile.at(TICK_S)

    def _use(self, profile: profiles.Profile) -> None:
        self._profile = profile
        self._profile_ticks, self._shift_s = 0, 0.0
        self._next_check_tick = 0
        self._pace = PathRate()

    def _advance_slowly(self) -> Motion:
        """The command of this tick, in a pause or on the way into or out of it."""
        self._shift_s += self._pace.advance(self._profile, self._profile_time_s, self._most_rad_s2)
        return self._pace.scaled(self._profile.at(self._profile_time_s))

    @property
    def _checked(self) -> bool:
        """Whether the path itself has checked this command; it does so for many ticks at once."""
        return self._profile is self._follow and self._follow.within_limits and self._pace.full

    @property
    def _most_rad_s2(self) -> list[float]:
        most = self.arm.traits.acceleration
        if self._seen.grip_n > SQUEEZE_N:
            return [min(a, profiles.LADEN_ACCELERATION_RAD_S2) for a in most]
        return most

    def _move_hand(self, motion: p.HandMotion) -> None:
        self._use_hand(HandCommand(motion.width_m, motion.force_n, motion.speed_m_s))

    def _use_hand(self, command: HandCommand) -> None:
        self._hand = command
        self.arm.command_hand(command)

    def _stiffen(self, law: p.ControlLaw) -> None:
        """Change from a compliant law to position control, from the measured motion: so the arm stops as quickly as any
        other, presses with nothing, and does not jump to where its spring would have pulled it."""
        still = [0.0] * len(self.sample.joints)
        self._command = (list(self.sample.joints), list(self.sample.velocities), still)
        self._compliant = False
        self.arm.use_law(p.ControlLaw(gains=law.gains, load=law.load))

    def _freeze_hand(self) -> None:
        """Stop the fingers. A hand that grips keeps its present force."""
        pressed, hand = self._seen.grip_n, self._hand
        if pressed < SQUEEZE_N:
            self._use_hand(HandCommand(self._seen.width_m, hand.force_n, hand.speed_m_s))
        else:
            self._use_hand(HandCommand(hand.width_m, min(pressed, hand.force_n), hand.speed_m_s))

    @property
    def _elapsed_s(self) -> float:
        """Since the start of the primitive, without its pauses."""
        return (self._ticks - self._motion.paused_ticks) * TICK_S

    @property
    def _profile_time_s(self) -> float:
        return self._profile_ticks * TICK_S + self._shift_s

    def _progress(self, now_s: float) -> m.ProgressReport:
        assert self.primitive is not None
        return m.ProgressReport(
            primitive=self.primitive_id,
            at_s=now_s,
            reading=reading(self.primitive.reporting.items or STANDARD, self.name, self._seen, ended=False),
        )

    def _end_report(self, now_s: float) -> m.EndReport:
        assert self.trip is not None
        assert self.primitive is not None
        return end_report(
            self.primitive_id,
            self.name,
            self.trip,
            at_s=now_s,
            duration_s=self._ticks * TICK_S,
            seen=self._seen,
            items=self.primitive.reporting.items,
            turned_rad=None if self._spindle is None else self._spindle.turned_rad,
        )


def _limp(law: p.ControlLaw) -> p.ControlLaw:
    """The law of the reflex COMPLY, with the load of the primitive."""
    return p.ControlLaw(name="impedance", gains=law.gains, load=law.load, compliance=LIMP)

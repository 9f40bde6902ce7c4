"""What the operator does with an arm during a `TeleopMotion`: who moves it, what they want, what proves DONE.
Pure: the time is an argument, the seconds of this process' clock.

A message counts if it is of this grant, recent, finite, of the one who moves the arm, and only about what is granted.
It holds for `LOST_S`; then the arm stops. This module must not know how an arm follows a twist.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from rtc.protocol.messages import Operate, TeleopState
from rtc.protocol.primitive import HandMotion, TeleopMotion
from rtc.protocol.units import in_words
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import TICK_S, SpindleCommand
from rtc.subsystems.motion.hand import Hand
from rtc.subsystems.motion.observation import Observation
from rtc.subsystems.motion.shared_way import SharedWay

LOST_S = 0.06  # a stream that is silent for this long is lost; the arm then needs up to 40 ms to stop
MOST_TWIST = 1000.0  # m/s, rad/s: a larger part of a twist is no hand of a person
STALE_S = 0.2  # a message that has seen nothing of this process for this long does nothing
TURNED = 0.98  # share of a turn that proves it
DONE_RAD = 0.02  # of the attitude that the program gives to a shared motion, at its end
TURNED_RAD = 1e-3  # what is left of a turn that is complete

BEYOND_M = 0.0005  # beyond the edge of the ball the tcp may only go back

NO_TWIST = (0.0,) * 6


class OperatedArm:
    def __init__(self, motion: TeleopMotion, seen: Observation, hand: Hand) -> None:
        self._motion, self._seen, self._hand = motion, seen, hand
        self._caller = b""  # who moves it; empty: no one
        self._operator = ""
        self._latest: Operate | None = None  # that counts
        self._at_s = -math.inf  # its arrival
        self.cut = ""  # why the arm moves less than wanted
        self.cut_by_arm: Callable[[], str] = str  # the same, of the arm that follows
        self.done = False
        self.paused = False
        self._turns = 0.0  # the present command of the spindle
        self._turned_rad = 0.0  # before it
        along = motion.along  # of the program, if the motion is shared
        self._way = SharedWay(along, motion.operator_axes, seen.arm.tcp_pose) if along is not None else None
        self._reach_m = max(motion.radius_m, self._off_m()) if motion.centre else math.inf

    # --- the stream --------------------------------------------------------------------------------------

    def objection(self, wanted: Operate, caller: bytes, now_s: float) -> str:
        """Why a message does nothing; empty: it counts, and is followed from now on."""
        if not all(map(math.isfinite, (*wanted.twist, wanted.turn, wanted.seen_at_s))):
            return "a number of it is not finite"
        if max(map(abs, wanted.twist)) > MOST_TWIST:  # in other axes its square is no number any more
            return f"a part of its twist is beyond {MOST_TWIST:g} m/s or rad/s"
        if self._is_moved_by_another(caller, now_s):
            return f"{self._operator} moves this arm; it is free after letting go"
        if (age_s := now_s - wanted.seen_at_s) > STALE_S:
            return f"stale: it has seen nothing of this subsystem for {age_s:.2f} s; {STALE_S:g} s are allowed"
        if age_s < -TICK_S:
            return "it names a time of this subsystem that has not come: its age is not known"
        if wanted.hand and not self._motion.hand:
            return "the hand is not part of this request"
        if wanted.turn and not self._motion.spindle:
            return "the spindle is not part of this request"
        if self.paused and wanted.hold:
            return "the command is paused; RESUME lets it go on"
        self._caller, self._operator = (caller, wanted.operator) if wanted.hold else (b"", "")
        self._latest, self._at_s = wanted, now_s
        return ""

    def _is_moved_by_another(self, caller: bytes, now_s: float) -> bool:
        return self._caller not in (b"", caller) and now_s - self._at_s <= STALE_S

    def follow(self, now_s: float) -> None:
        """Bring hand and spindle to what is wanted in this tick."""
        if self._latest is not None and (not self._latest.hold or now_s - self._at_s > LOST_S or self.paused):
            self._latest = None
        if self._caller and now_s - self._at_s > STALE_S:  # the operator is lost: another one may move the arm
            self._caller, self._operator = b"", ""
        wanted = self._latest
        self._turn(wanted.turn if wanted is not None else 0.0)
        if not self._motion.hand:
            return
        traits = self._seen.arm.traits
        if wanted is not None and wanted.hand:
            width_m = 0.0 if wanted.hand == "close" else traits.max_opening_m
            self._move_hand(HandMotion(width_m=width_m, force_n=self._motion.grip_n, speed_m_s=traits.hand_speed_m_s))
        elif not self._seen.fingers_rest() and not self._hand.grips:
            self._hand.freeze()

    def _move_hand(self, motion: HandMotion) -> None:
        command = self._hand.command
        if (command.width_m, command.force_n) != (motion.width_m, motion.force_n):
            self._hand.move(motion)

    def _turn(self, share: float) -> None:
        if share == self._turns:
            return
        self._turned_rad = self.turned_rad
        self._turns = share
        arm, motion = self._seen.arm, self._motion
        end_rad = motion.turn_rad if share * motion.turn_rad > 0.0 else 0.0
        left_rad = end_rad - self._turned_rad
        if not share or abs(left_rad) < TURNED_RAD or left_rad * share < 0.0:
            self._turns = 0.0
            arm.drive_spindle(None)
            return
        arm.drive_spindle(SpindleCommand(left_rad, abs(share) * motion.spindle_rad_s, motion.spindle_nm))

    @property
    def turned_rad(self) -> float:
        return self._turned_rad + (self._seen.arm.spindle().turned_rad if self._turns else 0.0)

    def stop(self) -> None:
        """The primitive ends, and with it the grant."""
        self._latest, self._caller, self._operator = None, b"", ""
        self._turn(0.0)

    # --- what is wanted ----------------------------------------------------------------------------------

    def twist(self, tcp: Array) -> list[float]:
        """The wanted velocity of the tcp (m/s, rad/s, world axes), within its speeds and inside its ball."""
        self.cut = ""
        wanted = self._latest
        if wanted is None:
            if self._way is not None:
                self._way.wait()
            return list(NO_TWIST)
        parts = wanted.twist
        if wanted.frame == "tool":
            parts = [*geometry.rotate(tcp, parts[:3]), *geometry.rotate(tcp, parts[3:])]
        linear, angular = _within(parts[:3], self._motion.speed_m_s), _within(parts[3:], self._motion.turn_rad_s)
        if self._way is not None:
            both = self._way.twist(tcp, [*linear, *angular])
            if self._way.waits_for:
                self.cut = f"the path waits: the arm is {self._way.waits_for}"
            return both
        if self._motion.centre and math.dist(tcp[:3], self._motion.centre) > self._reach_m + BEYOND_M:
            angular = [0.0] * 3  # near a singular posture a turn moves the tcp too
        return [*self._inside(linear, tcp), *angular]

    def _inside(self, linear: list[float], tcp: Array) -> list[float]:
        """The velocity without what would leave the ball: none outwards at its edge, little near it."""
        if not self._motion.centre:
            return linear
        away = [a - b for a, b in zip(tcp[:3], self._motion.centre, strict=True)]
        off_m = math.hypot(*away)
        if off_m < 1e-6:
            return linear
        outwards = sum(a * v for a, v in zip(away, linear, strict=True)) / off_m
        if off_m > self._reach_m + BEYOND_M and outwards >= 0.0:
            self.cut = f"the edge of the neighbourhood: {in_words(round(off_m, 3), 'm')} from its centre"
            return [0.0] * 3
        most = max(0.0, 5.0 * (self._reach_m - off_m))  # m/s: the edge is approached within 0.2 s
        if outwards <= most:
            return linear
        self.cut = f"the edge of the neighbourhood: {in_words(round(off_m, 3), 'm')} from its centre"
        return [v - (outwards - most) * a / off_m for a, v in zip(away, linear, strict=True)]

    # --- DONE --------------------------------------------------------------------------------------------

    def why_not_done(self) -> str:
        """What the measurements show against a DONE; empty: it is proved."""
        motion, seen = self._motion, self._seen
        if not seen.joints_rest() or not seen.fingers_rest() or self._latest is not None:
            return "the arm still moves: let go first"
        if self._way is not None and self._way.off(seen.tcp())[1] > DONE_RAD:
            return "the attitude is not yet that of the end of the way: hold a little longer"
        if motion.done_m is not None and (off_m := self._off_m()) > motion.done_m:
            there = f"it is {in_words(round(off_m, 4), 'm')} from where it should be"
            return f"{there}; {in_words(motion.done_m, 'm')} is near enough"
        if motion.done_grip_n is not None and seen.grip_n < motion.done_grip_n:
            return f"the fingers press with {seen.grip_n:.1f} N; {motion.done_grip_n:g} N are a grip"
        if motion.spindle and self.turned_rad / motion.turn_rad < TURNED:
            done, wanted = abs(self.turned_rad) / math.tau, abs(motion.turn_rad) / math.tau
            return f"the spindle has turned by {done:.2f} of {wanted:.2f} turns"
        return ""

    def _off_m(self) -> float:
        if self._way is not None:
            return self._way.off(self._seen.tcp())[0]
        return math.dist(self._seen.tcp()[:3], self._motion.centre)

    def look(self) -> TeleopState:
        """For telemetry."""
        motion, bounded = self._motion, bool(self._motion.centre)
        return TeleopState(
            request=motion.request,
            centre=motion.centre,
            radius_m=self._reach_m if bounded else None,
            off_m=self._off_m() if bounded or self._way is not None else None,
            done_m=motion.done_m,
            hand=motion.hand,
            spindle=motion.spindle,
            operator=self._operator,
            cut=self.cut_by_arm() or self.cut,
            towards=self._way.towards if self._way is not None else [],
        )


def _within(parts: list[float], most: float) -> list[float]:
    size = math.hypot(*parts)
    return list(parts) if size <= most else [part * most / size for part in parts]

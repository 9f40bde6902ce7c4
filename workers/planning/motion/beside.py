"""Motions of two arms at once: from when on one may start, so that the two cannot meet. Pure.

Either arm may be stopped anywhere on its path, at any time, and the other one goes on. So two motions may overlap in
time only if no posture of one meets any posture that the other still has before it. The part of a path that an arm has
left behind is free. A motion therefore starts at once, or when the other arm has come far enough along its trajectory.
The subsystem moves both arms, so it knows when that is.

The space that a motion needs first is mostly free before that which it needs last. So a motion may follow closely: it
starts when it would not have to wait on its way if nothing delayed either arm, and waits there if something does.

The search divides both paths into intervals and proves with one check that two intervals cannot meet, or divides them
further (`rtc.model.robot.separation`). It is conservative: it never calls two motions free that may meet.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rtc.model.robot.collision_scene import in_hands
from rtc.model.robot.quintic import Hermite, control_points, fine_times
from rtc.model.robot.separation import Interval, SeparationCheck
from rtc.protocol import causes
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused
from rtc.protocol.primitive import MAX_FURTHER, MAX_S, Box, JointTrajectory, Primitive, StartAfter, apart
from rtc.protocol.primitive_id import command_of
from rtc.spatial.geometry import Array
from workers.planning.motion.request import PlanningRequest
from workers.planning.motion.rest_to_rest import PIECES

SPACE_M = 0.01  # minimum distance of two moving arms from each other's path
STEP_M = 0.02  # smallest interval of a path: no point of the arm moves farther in it
FINE_S = 0.03  # distance of the times at which a path is evaluated; a hand at 5 m/s^2 is 0.6 mm off the line
SAME_RAD = 1e-9  # tolerance of a line in joint space
MAX_CHECKS = 6000  # beyond it what is not decided counts as meeting; some 20 ms, without compiled boxes 100 ms
SOFT_M = 0.1  # greatest distance of a compliant arm from its path that is taken into account
LAG_S = 0.05  # an arm is at most this far behind its command
CUTS = MAX_FURTHER  # parts of a path that may be followed closely; it may wait between two of them
BRAKE_S = 0.3  # the subsystem brakes about so long before the end of a part that it may not leave yet
WAIT_FACTOR, WAIT_MARGIN_S = 1.5, 2.0  # limit of the waits for another arm, from the time that it needs


class TimedPostures(NamedTuple):
    """A path in small intervals: the postures at their ends (rad), [n][joints], and the time of each (s)."""

    time_s: Array
    postures: Array


class Wait(NamedTuple):
    """Before I go on from `at_s` of my course, they must have come to `until_s` of theirs."""

    at_s: float
    until_s: float

    @property
    def start_s(self) -> float:
        """How far they must have come when I start, so that I need not wait there unless they are delayed (s)."""
        return self.until_s - max(0.0, self.at_s - BRAKE_S)


def start_conditions(
    request: PlanningRequest, motion: Primitive, others: Sequence[Primitive], *, follows: bool = False
) -> list[StartAfter]:
    """The conditions for the start of this motion beside the motions of other arms.

    `follows`: it may wait on its way, and be planned again from there. Raises Refused if the motion meets the place
    where another arm will come to rest.
    """
    conditions = []
    for other in others:
        pairs = [(arm, their) for arm in motion.paths for their in other.paths if their in request.joints]
        if set(motion.performers) & set(other.performers) or not pairs:
            continue
        if motion.space_mm and apart(motion.space_mm, other.space_mm or space_of(request, other)):
            continue
        cuts = CUTS if follows and len(pairs) == 1 and not _may_return(other) else 1
        found: list[Wait] = []
        for arm, their in pairs:
            needed = _waits(request, motion, arm, other, their, cuts)
            if needed is None:
                raise Refused(_in_the_way(arm, other, their))
            found += needed
        cell = request.world.cell
        if found and cell.subsystem_of(motion.performer) != cell.subsystem_of(other.performer):
            raise Refused(_in_the_way(motion.performer, other, other.performer))  # it cannot wait for another subsystem
        if found:
            conditions.append(_condition(other, found))
    return conditions


def _waits(
    request: PlanningRequest, motion: Primitive, arm: str, other: Primitive, their: str, cuts: int
) -> list[Wait] | None:
    """`waits` for this arm of the motion, and that arm of the other one."""
    check = request.world.compare_arms(arm, their, request.scene)
    paths = (motion.paths[arm], other.paths[their])
    mine, theirs = (course(*pair) for pair in zip(paths, check.reaches, strict=True))
    space_m = max(SPACE_M, _off_m(request, arm) + _off_m(request, their))
    return waits(check, mine, theirs, space_m + _softness_m(motion) + _softness_m(other), cuts)


def space_of(request: PlanningRequest, motion: Primitive) -> list[Box]:
    """Boxes around all that the arms of a motion may reach; empty where they cannot be computed (decision 0071).

    Two motions whose boxes do not touch keep from each other what `start_conditions` demands, whatever their times.
    """
    found: list[Box] = []
    for arm, path in motion.paths.items():
        boxes = request.world.space(arm, _rows(path), request.scene)
        if boxes is None:
            return []
        room_m = 0.5 * SPACE_M + _off_m(request, arm) + _softness_m(motion)
        low, high = np.floor(1e3 * (boxes[:, :3] - room_m)), np.ceil(1e3 * (boxes[:, 3:] + room_m))
        found += map(tuple, np.hstack((low, high)).astype(int).tolist())
    return found


def _rows(path: JointTrajectory) -> Array:
    """Joint values (rad) with lines between them that hold the path: of a line in joint space, its ends."""
    knots = path.time_s, path.positions, path.velocities, path.accelerations
    if len(path.time_s) <= PIECES + 1:
        points = control_points(*knots).positions.reshape(-1, len(path.positions[0]))  # the path is in their hull
        way = points[-1] - points[0]
        share = (points - points[0]) @ way / max(float(way @ way), 1e-12)
        if np.abs(points - points[0] - share[:, None] * way).max() < SAME_RAD:
            return points[0] + np.array((share.min(), share.max()))[:, None] * way
    return Hermite(*knots).at(fine_times(path.time_s, FINE_S))[:, 0]


def _off_m(request: PlanningRequest, arm: str) -> float:
    """How far what an arm holds may be from its believed place."""
    held = [name for name, by in in_hands(request.scene) if by == arm]
    return max((request.scene.pose_tolerance_m.get(name, 0.0) for name in held), default=0.0)


def _softness_m(motion: Primitive) -> float:
    """How far a compliant arm may be pushed away from its path."""
    law = motion.partner.control_law if motion.partner else motion.control_law
    compliance = law.compliance
    if compliance is None:
        return 0.0
    softest = min(compliance.stiffness[:3])
    if compliance.most_n is None or softest <= 0.0 or compliance.centre:  # about a centre the tcp gives way farther
        return SOFT_M
    return min(SOFT_M, compliance.most_n / softest)


def _may_return(motion: Primitive) -> bool:
    """A motion that may back off returns on its path, so its end must be awaited."""
    return any(stop.back_off_m > 0.0 for stop in motion.stop_functions)


def _condition(other: Primitive, found: Sequence[Wait]) -> StartAfter:
    """All waits for one motion: the start, and those on the way that are not met with it."""
    duration_s = other.paths[other.performer].duration_s

    def reached(until_s: float) -> float:
        late = until_s + LAG_S >= duration_s or _may_return(other)
        return MAX_S if late else until_s + LAG_S  # reached at its goal only

    path_s = max(0.0, *(reached(wait.start_s) for wait in found))
    further: list[tuple[float, float]] = []
    for wait in sorted(found):
        if reached(wait.until_s) > (further[-1][1] if further else path_s):
            further.append((wait.at_s, reached(wait.until_s)))
    within_s = WAIT_FACTOR * min(max(wait.until_s for wait in found) + LAG_S, duration_s) + WAIT_MARGIN_S
    return StartAfter(primitive=other.id, path_s=path_s, within_s=within_s, further=further)


def _in_the_way(arm: str, other: Primitive, their: str) -> Refusal:
    command = command_of(other.id)
    return Refusal(
        reason=RefusalReason.INFEASIBLE,
        message=f"{arm} would meet {their} where {command} brings it",
        owner=command,
        clears=by_person(f"wait until {command} has ended, or move {their} away"),
        cause=causes.SpaceTaken(arm=arm),
        in_the_way=their,
    )


def waits(
    check: SeparationCheck, mine: TimedPostures, theirs: TimedPostures, clearance_m: float, cuts: int = 1
) -> list[Wait] | None:
    """Where I wait for them, the last place first. My course is divided into so many parts; I wait between them.

    At each part that I am in, the rest of their course is clear of it, and of all parts before it. What I wait for is
    needed at the latest there; a wait that the start includes (`Wait.start_s`) is left out. None: their end is not
    clear of my path.
    """
    ways = check.ways(mine.postures, theirs.postures, clearance_m)
    end, count = len(theirs.time_s) - 1, len(mine.time_s) - 1
    found: list[Wait] = []
    mine_to, start = count, 0.0  # of my course: the rest is in `found`; and of theirs, when I start
    open_ = [(-end, Interval(0, end), Interval(0, count), 0)]  # their latest interval first
    for _ in range(MAX_CHECKS):
        if not open_ or (found and theirs.time_s[-open_[0][0]] <= start):
            return found
        _, late, part, known = heapq.heappop(open_)
        if part.first >= mine_to:
            continue
        near = ways.open(known, part, late)
        if near < 0:
            continue
        if late.length <= 1 and part.length <= 1:
            if late.last == end:
                return None
            mine_to = part.first * cuts // count * count // cuts  # the begin of its part
            found.append(Wait(float(mine.time_s[mine_to]), float(theirs.time_s[late.last])))
            start = max(start, found[-1].start_s)
        elif late.length > part.length:
            for half in _halves(late):
                heapq.heappush(open_, (-half.last, half, part, near))
        else:
            for half in _halves(part):
                heapq.heappush(open_, (-late.last, late, half, near))
    latest = max((late.last for _, late, part, _ in open_ if part.first < mine_to), default=0)
    if latest == end:
        return None
    return [*found, Wait(0.0, float(theirs.time_s[latest]))] if latest else found


def _halves(part: Interval) -> tuple[Interval, Interval]:
    middle = (part.first + part.last) // 2
    return Interval(part.first, middle), Interval(middle, part.last)


def course(path: JointTrajectory, reach: Array) -> TimedPostures:
    """The trajectory in intervals of at most STEP_M. `reach`: of each joint, as in `SeparationCheck.reaches`.

    Between two times FINE_S apart the line is used: the difference is small against SPACE_M."""
    time_s = fine_times(path.time_s, FINE_S)
    knots = Hermite(path.time_s, path.positions, path.velocities, path.accelerations).at(time_s)[:, 0]
    pieces = np.maximum(1, np.ceil(np.abs(np.diff(knots, axis=0)) @ reach / STEP_M)).astype(int)
    index = np.append(0, np.cumsum(pieces)).astype(float)
    at = np.arange(pieces.sum() + 1, dtype=float)
    postures = np.column_stack([np.interp(at, index, knots[:, n]) for n in range(knots.shape[1])])
    return TimedPostures(np.interp(at, index, time_s), postures)

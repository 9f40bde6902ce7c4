"""Motion planning: a timed, collision-free path that satisfies the constraints. Pure.

All `plan_…` and `find_…` raise Refused with the cause if there is none.

`plan_task_motion` plans a straight line or refuses. `plan_joint_motion` may choose its path by the paper's "generate,
test and modify" (R92). It tries a line in joint space, then a straight line of the hand, then a way found by sampling.
The first that passes is taken; `notes` record the attempts. Deterministic: the seed is part of the request.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
from msgspec.structs import replace

from rtc.model.robot.collision_scene import in_hands
from rtc.programs.schema import OWN
from rtc.protocol.causes import Collides, TooLong
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused, refuse_if
from rtc.spatial.geometry import Array, Floats
from workers.planning import axes
from workers.planning.motion import path as paths
from workers.planning.motion import planners, timings
from workers.planning.motion.path import Path
from workers.planning.motion.request import (
    FreeWay,
    PlanningRequest,
    blocked,
    fault,
    free_posture,
    is_free,
    is_soon_free,
    obstacle,
)
from workers.planning.motion.sampled_way import find_sampled_way, find_way_aside, guides, rounded
from workers.planning.motion.timing import Timed, slower

MORE_M = (0.020, 0.008)  # clearance of a freely chosen way beyond that of the request, where there is room
BACK_M = (0.05, 0.10, 0.15)  # lines back along the tool, to leave what is near
STRAIGHT = 0.8  # share of such a line that stays straight
CLOSER = 0.5  # share of the distance at the goal that is kept on the way there from a body that a later step touches
SOON = 1.5  # times the distance that such a body needs: a goal that is farther away from it leaves room for a way
SAME_RAD = 1e-6  # tolerance of the joint values at the end of a straight line
DIRECT = "generated a line in joint space; tested: free"


class Motion(msgspec.Struct, frozen=True, eq=False):
    path: Path
    timed: Timed
    goal_joints: Array
    goal_pose: Array
    notes: list[str] = []
    partner: Timed | None = None  # the motion of the second arm, if the request has one


def plan_task_motion(request: PlanningRequest, goal_pose: Floats) -> Motion:
    """Plan a straight tcp line to `goal_pose` (world)."""
    return in_time(request, find_task_way(request, goal_pose, request.way_margin_rad))


def find_task_way(request: PlanningRequest, goal_pose: Floats, margin_rad: float) -> FreeWay:
    """A straight tcp line that keeps `margin_rad` from every joint limit, without its timing."""
    line = paths.task_line(request.arm, request.start, goal_pose, margin_rad)
    refuse_if(fault(steered(request), line, least_room=True))
    return FreeWay(line, ["generated a straight line of the hand; tested: free"])


def find_curve(request: PlanningRequest, poses: Array, margin_rad: float) -> FreeWay:
    """The tcp through these poses (world, [poses][7]) from the start, with `margin_rad` from every joint limit."""
    line = paths.task_curve(request.arm, request.start, poses, margin_rad)
    refuse_if(fault(steered(request), line, least_room=True))
    return FreeWay(line, ["generated a curve of the hand; tested: free"])


def find_spline(request: PlanningRequest, postures: Sequence[Floats]) -> FreeWay:
    """A smooth curve in joint space through these postures (rad), the first of which is the start."""
    for posture in postures[1:]:
        refuse_if(request.arm.why_not_within(posture, request.way_margin_rad))
    way = paths.spline_through(postures)
    refuse_if(fault(request, way, least_room=True))
    return FreeWay(way, ["generated a spline through the places; tested: free"])


def plan_joint_motion(request: PlanningRequest, goal: Floats, before: Path | None = None) -> Motion:
    """Plan a motion to the joint values `goal` (rad) on any path, with more clearance than asked for where possible.

    `before`: a path that was free for a similar request. It is tested like any other."""
    return in_time(request, find_joint_way(request, goal, before))


def find_joint_way(request: PlanningRequest, goal: Floats, before: Path | None = None) -> FreeWay:
    """The path of `plan_joint_motion`, without its timing. What the arm may touch at the start is left on our lines,
    whatever planners the program names."""
    goal = np.asarray(goal, dtype=float)
    request = before_contact(request, goal)
    refuse_if(request.arm.why_not_within(goal, request.margin_rad))
    if request.algorithms.planners == [OWN] or may_touch_at_start(request):
        return _our_way(request, goal, before)
    return planners.find_way(request, goal, lambda: _our_way(request, goal, before))


def _our_way(request: PlanningRequest, goal: Array, before: Path | None) -> FreeWay:
    """The way of rtc's own planner. Raises Refused."""
    direct = paths.joint_line(request.start, goal)
    if is_soon_free(_wider(request, MORE_M[0]), direct):
        return FreeWay(direct, [DIRECT])
    refuse_if(_occupied(request, goal))
    return _generate_and_test(request, goal, direct, before)


def find_direct_way(request: PlanningRequest, goal: Floats, with_room: bool) -> FreeWay | None:
    """Test the line in joint space to `goal`. Raises Refused if the line is not free.

    `with_room`: test also with `MORE_M` to spare, and return the line if `plan_joint_motion` would take it.
    None: the line is free, but `plan_joint_motion` would try other ways first, or that was not tested.
    """
    goal = np.asarray(goal, dtype=float)
    refuse_if(request.arm.why_not_within(goal, request.margin_rad))
    line, request = paths.joint_line(request.start, goal), before_contact(request, goal)
    if with_room and is_soon_free(_wider(request, MORE_M[0]), line):
        return FreeWay(line, [DIRECT])
    if (problem := fault(request, line)) is not None:  # a goal that is taken is a better reason than the line to it
        raise Refused(_occupied(request, goal) or _leaving(request, problem))
    if not with_room:
        return None
    roomy = with_more_room(request, goal, MORE_M)
    return FreeWay(line, [DIRECT]) if roomy is request or is_free(roomy, line) else None


def _occupied(request: PlanningRequest, goal: Array) -> Refusal | None:
    """The problem with a posture; of several bodies that are too near, the nearest."""
    problem = free_posture(request)(goal)
    if problem is None or _in_contact(problem):
        return problem
    hits = request.world.too_near({**request.joints, request.arm.name: goal}, request.scene)
    return blocked(request, min(hits, key=lambda hit: hit.distance_m)) if hits else problem


def _in_contact(refusal: Refusal) -> bool:
    """Whether no clearance is missed: bodies are in contact, or the problem is another one."""
    return not isinstance(refusal.cause, Collides) or refusal.cause.distance_m <= 0.0


def before_contact(request: PlanningRequest, goal: Array) -> PlanningRequest:
    """The request for a way to where contact may begin: the bodies that a later step touches are obstacles like others.

    The goal may be nearer to them than they are uncertain, but not nearer than the clearance. Then the way keeps
    `CLOSER` of the distance at the goal. A goal that is hardly farther away than that would leave no way to it: there
    the way may be nearer than the goal by as much as with one that has just that distance."""
    ours = _ours(request)
    near = set(request.scene.near) - ours
    if not near:
        return request
    scene = replace(request.scene, near=())
    close, tolerance_m = dict(scene.close), {name: SOON * most_m for name, most_m in scene.pose_tolerance_m.items()}
    wider = replace(scene, clearance_m=SOON * scene.clearance_m, pose_tolerance_m=tolerance_m)
    for hit in request.world.too_near({**request.joints, request.arm.name: goal}, wider):
        for body in near & {hit.body_a.split()[0], hit.body_b.split()[0]}:
            nearer_m = (1.0 - CLOSER) * min(hit.distance_m, hit.margin_m / SOON)
            least_m = max(scene.clearance_m, hit.distance_m - nearer_m)
            close |= {(mine, body): min(least_m, close.get((mine, body), least_m)) for mine in ours}
    return replace(request, scene=replace(scene, close=close))


def steered(request: PlanningRequest) -> PlanningRequest:
    """The request for a line: a body that is nearer at the start than it is uncertain needs the clearance only."""
    scene, ours = request.scene, _ours(request)
    if not scene.pose_tolerance_m:
        return request
    hits = request.world.too_near(request.joints, scene)
    near = {body.split()[0] for hit in hits for body in (hit.body_a, hit.body_b) if hit.margin_m > scene.clearance_m}
    if not near - ours:
        return request
    close = {(mine, body): scene.clearance_m for mine in ours for body in near - ours}
    return replace(request, scene=replace(scene, close={**close, **scene.close}))


def _ours(request: PlanningRequest) -> set[str]:
    """The arm and what it holds."""
    held = (name for name, by in in_hands(request.scene) if by == request.arm.name)
    return {request.arm.name, *held}


def _leaving(request: PlanningRequest, refusal: Refusal) -> Refusal:
    """The refusal, with the body that the arm may touch already: it is why no way round the obstacle was sought."""
    body = may_touch_at_start(request)
    if not body:
        return refusal
    cause = refusal.cause if isinstance(refusal.cause, Collides) else None
    words = "" if cause and body in cause.owners else f"; no way round is sought from so near to {body}"
    leaving = msgspec.structs.replace(cause, leaving=body) if cause else refusal.cause
    return msgspec.structs.replace(refusal, message=refusal.message + words, cause=leaving)


def may_touch_at_start(request: PlanningRequest) -> str:
    """The body to which the arm is nearer than that is uncertain, so that they may touch; empty if there is none.

    Then it leaves on a line, which moves away from that body (`CollisionWorld.check_path`). A search would not know
    which way out is free, a hand at a handle for example. A body with a hinge is known but for its angle, so a way on
    which its distance only grows leads away from it."""
    if not request.scene.pose_tolerance_m:
        return ""
    hinged = {thing.name for thing in request.world.cell.objects if thing.hinge is not None}
    hits = request.world.too_near(request.joints, request.scene)
    found = [
        hit
        for hit in hits
        if hit.margin_m > request.scene.clearance_m
        and hinged.isdisjoint((hit.body_a.split()[0], hit.body_b.split()[0]))
    ]
    if not found:
        return ""
    hit, ours = min(found, key=lambda one: one.distance_m), _ours(request)
    bodies = [body.split()[0] for body in (hit.body_a, hit.body_b)]
    return next((body for body in bodies if body not in ours), bodies[1])


def with_more_room(request: PlanningRequest, goal: Array, more_m: Sequence[float]) -> PlanningRequest:
    """The request with the first of these additions to its clearance that start and goal allow; else unchanged."""
    ends = [{**request.joints, request.arm.name: end} for end in (goal, request.start)]
    for by_m in more_m:
        wider = _wider(request, by_m)
        if all(request.world.check(joints, wider.scene) is None for joints in ends):
            return wider
    return request


def _wider(request: PlanningRequest, by_m: float) -> PlanningRequest:
    return replace(request, scene=replace(request.scene, clearance_m=request.scene.clearance_m + by_m))


def _generate_and_test(request: PlanningRequest, goal: Array, direct: Path, before: Path | None) -> FreeWay:
    """Ways with more room come first, as far as they cost little: those that need no search. `direct`: the line."""
    leaves = may_touch_at_start(request)
    roomy = request if leaves else with_more_room(request, goal, MORE_M)
    first = obstacle(roomy, direct)
    if first is None:
        return FreeWay(direct, [DIRECT])
    notes = [f"generated a line in joint space; tested: {first.message}"]
    if before is not None and not leaves and _leads_aside(before, request.start, goal) and is_free(roomy, before):
        return FreeWay(before, [*notes, "modified: the way found for the script; tested: free"])
    lines = [direct]
    try:
        lines.append(straight := _straight(request, goal))
        refuse_if(obstacle(roomy, straight))
        return FreeWay(straight, [*notes, "modified: a straight line of the hand; tested: free"])
    except Refused as refused:
        notes.append(f"modified: a straight line of the hand; tested: {refused}")
    by_way_of = guides(request, goal)
    # A hand that may touch a handle leaves on a line. What it holds may also go up and back, or back and on.
    aside = find_way_aside(roomy, goal, by_way_of) if not leaves or len(_ours(request)) > 1 else None
    if aside is not None:
        return FreeWay(aside.path, [*notes, *aside.notes])
    if leaves:
        out = _back_and_on(request, goal) if len(_ours(request)) > 1 else None
        if out is None:
            raise Refused(_leaving(request, _narrowest(request, direct, first)))
        return FreeWay(out.path, [*notes, *out.notes])
    if roomy is not request:
        for way in lines:
            if is_free(request, way):
                return FreeWay(way, [*notes, "with less room: free"])
    sampled = find_sampled_way(request, roomy, [goal], by_way_of)
    if isinstance(sampled, FreeWay):
        return FreeWay(sampled.path, [*notes, *sampled.notes])
    if _begins_narrow(request) and (out := _back_and_on(request, goal)) is not None:
        return FreeWay(out.path, [*notes, *out.notes])
    first = _narrowest(request, direct, first)
    words = f"{first.message}; no way round it was found in {sampled} samples"
    raise Refused(msgspec.structs.replace(first, message=words).after(samples=sampled))


def _narrowest(request: PlanningRequest, way: Path, first: Refusal) -> Refusal:
    """The fault of a way where its bodies are nearest, or the first one if they collide there: another way may have
    room. `first`: what a way with more room meets."""
    found = fault(request, way, least_room=True)
    if found is not None and _in_contact(found):
        found = fault(request, way)
    return found or first


def _back_and_on(request: PlanningRequest, goal: Array) -> FreeWay | None:
    """A way that leaves a narrow place as RETRACT does, on a line back along the tool, and is searched from the end of
    that line. None: not found.

    What the arm may touch is left straight: the way bends at the end of the line only, and nothing is so near there."""
    here, test = request.arm.fk(request.start), free_posture(request)
    for by_m in BACK_M:
        try:
            back = axes.shifted(here, "TOOL-Z", -by_m)
            line = paths.task_line(request.arm, request.start, back, request.way_margin_rad)
            refuse_if(fault(request, line))
        except Refused:
            return None  # a longer line begins with this one
        left, end = out = line.joints_at(np.array((STRAIGHT, 1.0)) * line.length)
        if any(test(q) is not None for q in out):
            continue  # still so near
        way = rounded(request, [request.start, left, end, goal])
        if way is None:
            behind = replace(request, joints={**request.joints, request.arm.name: end})
            found = find_sampled_way(behind, behind, [goal], guides(behind, goal))
            way = rounded(request, [request.start, left, *found.path.knots]) if isinstance(found, FreeWay) else None
        words = f"modified: back by {by_m:g} m, and on"
        return None if way is None else FreeWay(way, [f"{words} by way of {len(way.knots) - 4} points; tested: free"])
    return None


def _begins_narrow(request: PlanningRequest) -> bool:
    """Whether the start has nearly less room than the clearance, so that a search hardly finds out."""
    more_m = request.scene.clearance_m + min(MORE_M)
    return request.world.check(request.joints, replace(request.scene, clearance_m=more_m)) is not None


def _leads_aside(way: Path, start: Array, goal: Array) -> bool:
    """Whether a path has these ends, and is not the line in joint space."""
    ends = np.array_equal(way.knots[0], start) and np.array_equal(way.knots[-1], goal)
    return ends and way.curve is not None


def _straight(request: PlanningRequest, goal: Array) -> Path:
    """The straight line of the hand to the pose of `goal`. Raises Refused if it ends with other joint values."""
    line = paths.task_line(request.arm, request.start, request.arm.fk(goal), request.way_margin_rad)
    if np.abs(line.knots[-1] - goal).max() < SAME_RAD:
        return line
    message = f"{request.arm.name} would end with other joint values"
    raise Refused.because(RefusalReason.INFEASIBLE, message)


def slowed_to(motion: Motion, takes_s: float) -> Motion:
    """The motion on the same path, made slower so that it lasts `takes_s`. Raises Refused if it cannot be that fast."""
    least_s = motion.timed.duration_s
    if takes_s < least_s:
        raise Refused.because(
            RefusalReason.INFEASIBLE,
            f"this motion shall take {takes_s:.3g} s; the arm needs {least_s:.3g} s for it",
            clears=f"takes_s of at least {least_s:.3g} s, or a higher speed",
            cause=TooLong(limit_s=takes_s, predicted_s=least_s),
        )
    by = takes_s / least_s
    partner = slower(motion.partner, by) if motion.partner is not None else None
    return replace(motion, timed=slower(motion.timed, by), partner=partner)


def in_time(request: PlanningRequest, found: FreeWay) -> Motion:
    """The way as a motion, timed at the pace of the request. Raises Refused for a load that is too heavy for it."""
    timed, notes = timings.time_path(request, found.path)
    goal = found.path.knots[-1]
    return Motion(found.path, timed, goal, request.arm.fk(goal), [*found.notes, *notes])

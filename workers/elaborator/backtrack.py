"""Binding search: plans a script's bindings backwards from its goal, then tests the chain forwards (R92, R134). Pure.

generate  all inverse solutions at the goal, nearest first
test      each path segment of the script in order, from the arm's position: limits, lines, collisions
modify    the next solution if one is blocked; if all are blocked, ways round by sampling

The first that passes is taken; `notes` record the attempts. Values known only at execution time (a step relative to the
current hand pose, a measured pose) are tested with their planned values.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from rtc.model.cells import parts
from rtc.programs import expressions, extension_names
from rtc.programs.schema import PlanLine, ScriptFile
from rtc.protocol.causes import OutOfReach
from rtc.protocol.messages import Binding, OperateStep, PathStep, PlannedPath, SharedStep, Step, WorldChange
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused
from rtc.protocol.sentence import Constraint, ParsedCommand, Quantity
from rtc.protocol.spelling import unknown
from rtc.spatial import geometry
from rtc.spatial.axis_names import AXES
from rtc.spatial.geometry import Array
from rtc.world.model import location
from workers.elaborator.anchors import ANCHORS
from workers.mechanisms.collision_advice import advise_on_collision
from workers.planning import axes, in_seat, scenes, segments, shared_hold, suggestions, trust
from workers.planning.motion import ik
from workers.planning.motion.request import PlanningRequest
from workers.planning.motion.timing import SpeedLimits
from workers.planning.segments import Target
from workers.planning.step_target import target_of
from workers.tasks.anchor import POSE_OF_JOINTS, Anchor, named
from workers.tasks.candidate import TaskCandidate, lets_go_first
from workers.tasks.sentence_of import sentence_of

MAX_DETOURED = 3  # maximum number of inverse solutions to which ways round are searched
FRAME, GRASP = "frame", "grasp"  # attributes that cameras sense
NEIGHBORS = "AVOID-NEIGHBORS"
OPERATE = "operate"  # step that a person performs


class Planned(msgspec.Struct, frozen=True):
    bindings: dict[str, Binding]
    relies_on: list[str]  # keys of the facts used
    notes: list[str]
    chosen: bool  # one of several inverse solutions was chosen
    ways: dict[int, PlannedPath]  # free way of the first segment, by index of its step in the script
    doubtful: list[str]  # bodies whose poses it uses although they are not trusted: a camera looks for them first
    end: Array | None  # rad, joint values of the arm after its last motion; None: it does not move
    changes: list[WorldChange] | None = None  # of the world by its success, as predicted; None: not known

    @staticmethod
    def nothing() -> Planned:
        return Planned({}, [], [], False, {}, [], None)


def plan(script: ScriptFile, steps: Sequence[Step], candidate: TaskCandidate) -> Planned:
    """The tested bindings of the script for this candidate. Raises Refused with the obstacle.

    `steps`: of the script, for this candidate.
    """
    lines = _lines(script, candidate)
    relies_on = list(dict.fromkeys(key for anchor in lines.values() for key in anchor.relies_on))
    doubtful: list[str] = []
    for key in relies_on:
        distrusted = trust.distrusted(candidate.query, key, candidate.program.clears)
        if distrusted is not None and not can_be_seen(distrusted.where, candidate):
            raise Refused(distrusted)
        if distrusted is not None and location(distrusted.where) not in doubtful:
            doubtful.append(location(distrusted.where))
    joints, notes, ways, end = _search(script, steps, candidate, lines, set(doubtful))
    chosen = any(line.solve and lines[line.name].joints is None for line in script.plan)
    return Planned(_bindings(lines, joints), relies_on, notes, chosen, ways, doubtful, end)


def can_be_seen(key: str, candidate: TaskCandidate) -> bool:
    """Whether a camera can sense this fact before the script begins (R151). The fact is the pose of a free object or of
    a seat, or how the arm holds an object. The poses of the plan that depend on it are restated after the look. That
    needs a belief near the truth: a pose that is unknown or disproved is to be located by a command of its own."""
    body, _, attribute = key.rpartition(".")
    holder = candidate.query.held_by(body)
    senses = attribute in (FRAME, GRASP) and attribute in candidate.program.senses
    fits = holder == (candidate.arm.name if attribute == GRASP else "")
    near = candidate.query.placed(body) and not candidate.query.mover_of(key)
    return senses and fits and near and bool(candidate.query.cameras(body))


# --- the poses, backwards from the goal ------------------------------------------------------------------


def _lines(script: ScriptFile, candidate: TaskCandidate) -> dict[str, Anchor]:
    lines: dict[str, Anchor] = {}
    for n, line in enumerate(script.plan):
        with _AtPlace(f"{script.script}.plan[{n}] ({line.name})", words=""):
            anchor = lines[line.at] if line.at in lines else _anchor(line, candidate)
            lines[line.name] = _moved(anchor, line, candidate)
    for name, place in zip(candidate.vias, candidate.parsed.through, strict=True):
        with _AtPlace(f"THROUGH {place}", words=f"THROUGH {place}"):
            lines[name] = named(candidate, place)
    return lines


def _anchor(line: PlanLine, candidate: TaskCandidate) -> Anchor:
    if line.at not in ANCHORS:
        raise _program(unknown("plan anchor or earlier line", line.at, ANCHORS))
    return ANCHORS[line.at](candidate)


def _moved(anchor: Anchor, line: PlanLine, candidate: TaskCandidate) -> Anchor:
    if not line.along:
        return anchor
    try:
        by_m, turn_rad = (expressions.number(value, candidate.figures) for value in (line.by, line.turn_rad))
    except expressions.ExpressionError as error:
        raise _program(f"{line.by}, {line.turn_rad}: {error}") from error
    pose = anchor.pose or candidate.query.model.arms[candidate.arm.name].fk(anchor.joints or ()).tolist()
    frame = candidate.query.pose(anchor.frame) if anchor.frame else geometry.IDENTITY
    world = geometry.compose(frame, pose)
    if line.along == extension_names.WAY_OUT:
        if candidate.target is None:
            raise _program("WAY-OUT is the way out of a seat, and the sentence names none")
        moved = geometry.translate(world, by_m * _way_out(candidate, candidate.target))
    elif line.along in AXES:
        moved = axes.turned(axes.shifted(world, line.along, by_m), line.along, turn_rad)
    else:
        raise suggestions.unknown("axis", line.along, extension_names.PLAN_AXES)
    return replace(anchor, joints=None, pose=geometry.relative(frame, moved).tolist())


def _way_out(candidate: TaskCandidate, target: parts.Seat) -> Array:
    """Unit vector (world) out of the target seat: for an object that is in it, as that leaves it."""
    query, thing = candidate.query, candidate.thing
    if thing is not None and target.name in (query.seat(thing.name), query.seat_around(thing.name)):
        return query.leaves_along(thing.name)
    return query.out_of(target.name)


def _bindings(lines: dict[str, Anchor], joints: dict[str, list[float]]) -> dict[str, Binding]:
    bindings: dict[str, Binding] = {}
    for name, anchor in lines.items():
        made = Binding(pose=anchor.pose, frame=anchor.frame, grasp=anchor.grasp)
        pose = made if anchor.pose is not None else None
        if name in joints:
            bindings[name] = Binding(joints=joints[name])
            if pose is not None and anchor.frame:
                bindings[name + POSE_OF_JOINTS] = pose
        else:
            bindings[name] = pose or Binding(joints=anchor.joints)
    return bindings


# --- the joints, tried forwards --------------------------------------------------------------------------


class _RefusedOutside(Refused):
    """Refused after the held object has left its seat."""


Solved = tuple[dict[str, list[float]], list[str], dict[int, PlannedPath], Array | None]


def _search(
    script: ScriptFile, steps: Sequence[Step], candidate: TaskCandidate, lines: dict[str, Anchor], sensed: set[str]
) -> Solved:
    """`sensed`: bodies whose poses are measured before the script begins, so that their spread does not count."""
    request = _request(script, candidate, sensed)
    _refuse_beyond_reach(steps, candidate, lines, request)
    solvers: dict[str, None] = {}
    ways = list(_ways(script, candidate, lines, request, solvers))
    if not ways:
        raise _unreachable(script, candidate, lines, request)
    lines_too = any(step.to and step.space != "move_joint" for step in steps)
    straight = _straight(script, candidate, request) if lines_too else request
    notes: list[str] = list(solvers)
    first: Refusal | None = None
    has_left = False
    its_ranks = (False, False)
    searched = 0
    for n, joints, detours in _order(ways):
        if detours and searched == MAX_DETOURED:
            break
        what = f"way {n} of {len(ways)}" + (" with detours" if detours else "")
        try:
            found, end = _try(steps, candidate, lines, joints, request, straight, detours)
            return joints, [*notes, f"generated {what}; tested: free"] if script.plan else [], found, end
        except Refused as refused:
            tried, refused_outside = refused.refusal, isinstance(refused, _RefusedOutside)
        notes.append(f"generated {what}; tested: {tried.message}")
        if tried.effort is not None and tried.effort.samples is not None:
            searched += 1
        # An arm in the way may leave, so the command can wait for it. With detours a way round was searched, or another
        # segment is blocked whatever way leads to it: this is a better reason than a blocked direct way.
        ranks = (bool(tried.in_the_way), detours)
        if first is None or ranks > its_ranks:
            first, its_ranks, has_left = tried, ranks, refused_outside
    assert first is not None
    clears, limits = candidate.program.clears, candidate.limits
    goal = (candidate.parsed.place.name if candidate.parsed.place else None) or ""
    out = any(step.words.get("leaves") == "seat" for step in script.steps)
    closer = partial(_closer, candidate.parsed)
    query, arm = candidate.query, candidate.arm.name
    first = advise_on_collision(first, query, arm, clears, limits, goal, out, closer, has_left=has_left)
    raise Refused(first.after(ways_tried=len(ways)))


def _closer(parsed: ParsedCommand, room_mm: int) -> str:
    """The same sentence with another AVOID-NEIGHBORS; empty if it cannot be written."""
    others = [one for one in parsed.constraints if one.slot != NEIGHBORS]
    room = Constraint(slot=NEIGHBORS, value=Quantity(value=room_mm / 1000.0, unit="m"))
    return sentence_of(replace(parsed, constraints=[*others, room]))


def _order(ways: list[dict[str, list[float]]]) -> Iterator[tuple[int, dict[str, list[float]], bool]]:
    """Attempts in order, as (number, joint values, with detours).

    The nearest solution with a detour is better than a distant solution that turns the arm over. Detours are expensive,
    so the nearest direct solutions come first. `_search` ends after `MAX_DETOURED` searches.
    """
    numbered = list(enumerate(ways, 1))
    head, tail = numbered[:MAX_DETOURED], numbered[MAX_DETOURED:]
    yield from ((n, way, False) for n, way in head)
    yield from ((n, way, True) for n, way in head[:1])
    yield from ((n, way, False) for n, way in tail)
    yield from ((n, way, True) for n, way in numbered[1:])


def _request(script: ScriptFile, candidate: TaskCandidate, sensed: set[str]) -> PlanningRequest:
    query = candidate.query
    if lets_go_first(script) and query.holding(candidate.arm.name):
        query = shared_hold.after_letting_go(query, candidate.arm.name)
    holds = query.holding(candidate.arm.name)
    scene = scenes.scene_of(
        query,
        candidate.arm.name,
        candidate.limits,
        ignore_suspect=script.despite_grasp,
        opening_m=None if holds else candidate.figures.get("pre_grasp_m"),
        exempt=[body.name for body in (candidate.thing, candidate.target) if body],
    )
    if sensed:
        scene = replace(
            scene, pose_tolerance_m={name: m for name, m in scene.pose_tolerance_m.items() if name not in sensed}
        )
    margin_rad = math.radians(candidate.figures["joint_margin_deg"])
    request = scenes.planning_request(query, candidate.arm.name, scene, candidate.limits, SpeedLimits(), margin_rad)
    if candidate.partner is None:
        return request
    return replace(request, partner=query.model.arms[candidate.partner.name])


def _ways(
    script: ScriptFile,
    candidate: TaskCandidate,
    lines: dict[str, Anchor],
    request: PlanningRequest,
    solvers: dict[str, None],
) -> Iterator[dict[str, list[float]]]:
    """Joint values for all lines with `solve`: each branch of the first line, and for the others the nearest branch.
    Notes on who has solved are added to `solvers`."""
    wanted = [line for line in script.plan if line.solve]
    if not wanted:
        yield {}
        return
    first, *others = wanted

    def branches(anchor: Anchor, near: list[float]) -> list[list[float]]:
        pose = _world(candidate, anchor)
        found = ik.solutions(request.algorithms.ik, request.arm, pose, near, request.margin_rad)
        solvers.update(dict.fromkeys(found.notes))
        return [q.tolist() for q in found.found]

    given = lines[first.name].joints
    heads = [given] if given is not None else branches(lines[first.name], request.start.tolist())
    for head in heads:
        joints = {first.name: head}
        for line in others:
            anchor = lines[line.name]
            near = joints.get(line.near, head)
            found = [anchor.joints] if anchor.joints is not None else branches(anchor, near)[:1]
            if found:
                joints[line.name] = found[0]
        if len(joints) == len(wanted):
            yield joints


def _world(candidate: TaskCandidate, anchor: Anchor) -> list[float]:
    assert anchor.pose is not None
    frame = candidate.query.pose(anchor.frame) if anchor.frame else geometry.IDENTITY
    return geometry.compose(frame, anchor.pose).tolist()


def _unreachable(
    script: ScriptFile, candidate: TaskCandidate, lines: dict[str, Anchor], request: PlanningRequest
) -> Refused:
    for line in script.plan:
        if line.solve and lines[line.name].joints is None:
            pose, solvers = _world(candidate, lines[line.name]), request.algorithms.ik
            if not ik.solutions(solvers, request.arm, pose, None, request.margin_rad).found:
                why = ik.why_none(solvers, request.arm, pose, request.margin_rad)
                return Refused(_where(why, line.name, words=""))
    message = f"{candidate.arm.name} cannot reach the postures of the plan in one chain"
    return Refused.because(RefusalReason.INFEASIBLE, message)


def _refuse_beyond_reach(
    steps: Sequence[Step], candidate: TaskCandidate, lines: dict[str, Anchor], request: PlanningRequest
) -> None:
    """Refuse to ask the operator for a place that the arm does not reach."""
    for name in dict.fromkeys(step.place for step in steps if isinstance(step, OperateStep | SharedStep)):
        if name in lines and lines[name].pose is not None and lines[name].joints is None:
            why = request.arm.why_no_ik(_world(candidate, lines[name]))
            if why is not None and isinstance(why.cause, OutOfReach):
                raise Refused(_where(why, name, words=""))


def _try(
    steps: Sequence[Step],
    candidate: TaskCandidate,
    lines: dict[str, Anchor],
    joints: dict[str, list[float]],
    request: PlanningRequest,
    straight: PlanningRequest,
    detours: bool,
) -> tuple[dict[int, PlannedPath], Array | None]:
    """Test the segments in order; the way of the first segment, by index of its step, and the end of the last one. The
    later segments start where the arm will come to rest, which is not known yet. Raises Refused for the first blocked
    one."""
    here = start = request.start
    ways: dict[int, PlannedPath] = {}
    last: _Test | None = None
    has_left = False
    bound = partial(_bound, candidate, lines, joints)
    thing = candidate.thing.name if candidate.thing else ""
    for n, step in enumerate(steps, 1):
        if isinstance(step, OperateStep) and step.place:
            _refuse_outside_limits(request, candidate, joints.get(step.place), lines[step.place])
            here = np.asarray(joints.get(step.place, here), dtype=float)  # where the operator brings it
        if not isinstance(step, PathStep):
            continue
        outside = has_left and not step.leaves_seat
        asked = request if step.space == "move_joint" else straight
        asked = _out_of_seat(asked, candidate) if outside else asked
        now = asked if here is start else replace(asked, joints={**request.joints, candidate.arm.name: here})
        tcp, clears = now.arm.fk(here), candidate.program.clears
        with _AtPlace(f"step {n} ({step.to})", words=f"step {n}"):
            target = target_of(step, candidate.query, candidate.arm.name, thing, tcp, bound)
        if step.space not in segments.SPACES:
            raise _program(f"step {n}: {unknown('space', step.space, segments.SPACES)}")
        in_seat.refuse_other_way(candidate.query, candidate.arm.name, step, tcp, target.pose, clears)
        test = _Test(n, step, now, target, detours, first=here is start)
        if detours and test.first and step.space == "move_joint" and target.joints is not None:
            last, here = test, np.asarray(target.joints, dtype=float)  # a search is expensive: after the other segments
            continue
        try:
            here = test.run(ways).end
        except Refused as refused:
            if not outside:
                raise
            raise _RefusedOutside(refused.refusal) from None
        has_left = has_left or step.leaves_seat
    if last is not None:
        last.run(ways)
    return ways, None if here is start else here


def _refuse_outside_limits(
    request: PlanningRequest, candidate: TaskCandidate, joints: list[float] | None, anchor: Anchor
) -> None:
    """Refuse a place to which the operator is asked to bring the hand, if every posture there breaks a limit of the
    sentence. How the arm gets there is the operator's; `joints`: of the plan, if it has solved the place."""
    given = joints if joints is not None else anchor.joints
    found = [np.asarray(given, dtype=float)] if given is not None else []
    if not found:
        pose = _world(candidate, anchor)
        found = ik.solutions(request.algorithms.ik, request.arm, pose, request.start, request.margin_rad).found
    why = [_outside_limits(request, posture) for posture in found]
    if why and why[0] is not None and None not in why:
        raise Refused(why[0])


def _outside_limits(request: PlanningRequest, joints: Array) -> Refusal | None:
    """The refusal of a posture (rad) that is in a region to avoid, or outside another limit of the path."""
    at, regions = {**request.joints, request.arm.name: joints}, set(request.scene.keep_out)
    hits = request.world.too_near(at, request.scene) if regions else []
    inside = next((hit for hit in hits if hit.body_b.split()[0] in regions), None)
    return inside.refusal() if inside is not None else request.path_constraints.violation(request.arm, joints)


def _out_of_seat(request: PlanningRequest, candidate: TaskCandidate) -> PlanningRequest:
    """The request for the steps after the held object has left its seat, from which it then keeps its distance."""
    seat = candidate.query.seat(candidate.query.holding(candidate.arm.name))
    near = [name for name in request.scene.near if name != seat]
    return replace(request, scene=replace(request.scene, near=near))


def _straight(script: ScriptFile, candidate: TaskCandidate, request: PlanningRequest) -> PlanningRequest:
    """The request for lines and curves. Those of a script about an object touch it, or a held one its seat or the
    target; and those that only back off. They need no more distance than the clearance from other bodies."""
    query, arm, thing, target = candidate.query, candidate.arm.name, candidate.thing, candidate.target
    held = "" if lets_go_first(script) else query.holding(arm)
    contacts: list[tuple[str, str]] = []
    if held and (thing is not None or candidate.partner is not None):
        contacts = scenes.seat_contacts(query, held, [target.name] if target else [])
        if thing is not None and thing.thread is not None:
            contacts += scenes.hand_contacts(query, arm, thing.name)
    elif thing is not None and not held:
        contacts = scenes.hand_contacts(query, arm, thing.name)
    scene = request.scene
    touches = (thing is not None or target is not None or script.despite_grasp) and candidate.partner is None
    scene = replace(
        scene,
        close=scenes.beside_bolt(query, arm, thing.name if thing is not None else ""),
        pose_tolerance_m={} if touches else scene.pose_tolerance_m,
        ignore=[*scene.ignore, *contacts],
    )
    return replace(request, scene=scene)


class _Test(NamedTuple):
    """The test of one segment."""

    n: int  # of its step, from 1
    step: PathStep
    request: PlanningRequest
    target: Target
    detours: bool
    first: bool  # it starts where the arm is

    def run(self, ways: dict[int, PlannedPath]) -> segments.FreeSegment:
        """The segment; the way of the first one is added to `ways`."""
        space = self.step.space
        with _AtPlace(f"step {self.n} ({self.step.to})", words=f"step {self.n}"):
            segment = segments.check_segment(self.request, space, self.target, self.detours, self.first)
        if self.first and (way := segment.way(self.request, space)) is not None:
            ways[self.n - 1] = way
        return segment


def _bound(candidate: TaskCandidate, lines: dict[str, Anchor], joints: dict[str, list[float]], name: str) -> Target:
    """The target that a line of the plan stands for."""
    if name in joints:
        return Target(joints=joints[name])
    if name not in lines:
        raise _program(f"nothing binds {name}")
    return _at(candidate, lines[name])


def _at(candidate: TaskCandidate, anchor: Anchor) -> Target:
    return Target(joints=anchor.joints) if anchor.joints is not None else Target(pose=_world(candidate, anchor))


class _AtPlace(NamedTuple):
    """Adds the place to a refusal that is raised inside."""

    where: str
    words: str  # the same for the operator, who does not know lines of plans

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, raised: BaseException | None, _: object) -> None:
        if isinstance(raised, Refused):
            raise Refused(_where(raised.refusal, self.where, self.words)) from None


def _where(refusal: Refusal, where: str, words: str) -> Refusal:
    """Add the place to the refusal; to its message too, in words if a segment is blocked, as it is if the program is
    wrong. An unknown name is a place of the sentence."""
    if refusal.reason is RefusalReason.NAME and refusal.where:
        return refusal
    place = f"{where}, {refusal.where}" if refusal.where else where
    named = {RefusalReason.INFEASIBLE: words, RefusalReason.PROGRAM: where}.get(refusal.reason, "")
    message = f"{named}: {refusal.message}" if named else refusal.message
    return msgspec.structs.replace(refusal, where=place, message=message)


def _program(message: str) -> Refused:
    return Refused.because(RefusalReason.PROGRAM, message, clears="LOAD a corrected script")

"""The sentence that moves another arm out of the way of a command, tested before it is stated. Pure.

An arm without a command does not leave by itself, and no command moves another arm than its own. So the refusal states
a sentence for that arm. It is tested by planning: the arm can go there, and the command can be planned after that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import msgspec
from msgspec.structs import replace

from rtc.language.hands import hand_in_words
from rtc.protocol.advice import fill_in
from rtc.protocol.messages import Limits, WorldChange
from rtc.protocol.outcomes import Refusal, Refused
from rtc.spatial.geometry import Floats
from workers.planning import scenes
from workers.planning.motion import ik
from workers.planning.motion.plan import find_joint_way
from workers.planning.motion.timing import SpeedLimits
from workers.planning.world_query import WorldQuery
from workers.tasks.candidate import TaskCandidate


def advise(
    refusal: Refusal, candidate: TaskCandidate, other: str, can_be_planned: Callable[[TaskCandidate], bool]
) -> Refusal | None:
    """The refusal with the sentence that clears it; None if none was found. `other`: the arm in the way, which may
    leave."""
    query, clears = candidate.query, candidate.program.clears
    for row, place, joints in _leaves(query, other):
        there = WorldChange(key=f"{other}.joints", value=[float(q) for q in joints])
        after = replace(candidate, query=query.after([there]))
        if can_be_planned(after) and _can_go(query, other, joints):
            advice = fill_in(clears.get(row, []), {"other": hand_in_words(other), "place": place})
            return msgspec.structs.replace(refusal, clears=advice)
    return None


def may_leave(query: WorldQuery, arm: str) -> bool:
    """Whether a sentence may move this arm alone, as far as what it does and holds is concerned."""
    held = query.holding(arm)
    moves = any(arm in primitive.paths for primitive in query.moving)
    free = not held or (query.hinge(held) is None and not query.sharers(arm) and query.trusts(f"{held}.grasp"))
    return free and not moves


def _leaves(query: WorldQuery, arm: str) -> Iterator[tuple[str, str, Floats]]:
    """Rows of the advice, with a named place if there is one, and the joint values (rad) of the arm there."""
    spec, model = query.cell.arm(arm), query.model.arms[arm]
    yield "way_stow", "", spec.stow_rad
    for place in query.places:
        joints: Floats | None = place.joints_rad(arm)
        if joints is None and (frame := place.poses.get(arm)) is not None:
            pose, near = frame.pose.tolist(), query.joints(arm)
            found = ik.solutions(query.algorithms.ik, model, pose, near, _margin_rad(query)).found
            joints = next(iter(found), None)
        if joints is not None:
            yield "way_place", place.name, joints


def _can_go(query: WorldQuery, arm: str, joints: Floats) -> bool:
    scene = scenes.scene_of(query, arm, Limits(), seated=bool(query.holding(arm)))
    request = scenes.planning_request(query, arm, scene, Limits(), SpeedLimits(), _margin_rad(query))
    try:
        find_joint_way(request, joints)
    except Refused:
        return False
    return True


def _margin_rad(query: WorldQuery) -> float:
    return math.radians(query.cell.numbers.joint_margin_deg)

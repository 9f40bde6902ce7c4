"""What a report, or a stated fact, says about an object with a hinge: its angle, and how well it is known. Pure."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

import msgspec
import numpy as np

from rtc.model.cells import parts
from rtc.protocol.messages import CircleStep, MoveStep, WorldChange
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.units import figure
from rtc.spatial import geometry, hinges
from workers.planning import pose_spread
from workers.planning.step_target import TURN
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import AnalyzeTask, Changes

BACK_RAD = 0.1  # a hand that was to turn one way has turned the other way by less
HINGE_OFF_M = 0.05  # maximum error of a hinge's place on its body in the cell file
HINGE_OFF_RAD = 0.1  # maximum error of its axis, and of an angle at a stop


def left(task: AnalyzeTask) -> str | None:
    """The angle that is left of a sentence, as its amount; empty: none. None: the step turns nothing about a hinge."""
    if (wanted := _wanted_rad(task)) is None:
        return None
    left_rad = wanted - _gone_rad(task)
    return f"{figure(math.degrees(left_rad))} DEG" if left_rad > task.values["angle_rad"] else ""


def has_turned(task: AnalyzeTask) -> bool:
    """Whether a step that ends by a turn about a hinge has turned as far. Where the hand is then depends on where the
    hinge truly is."""
    wanted = _wanted_rad(task)
    return wanted is not None and _gone_rad(task) >= wanted - task.values["angle_rad"]


def _wanted_rad(task: AnalyzeTask) -> float | None:
    """By how much the hand was to turn about a hinge in this step; None of steps that do not end by such a turn."""
    hinged = bool(task.evaluation.held) and task.query.hinge(task.evaluation.held) is not None
    return task.step.overrides.get(TURN) if hinged else None


def _gone_rad(task: AnalyzeTask) -> float:
    """By how much the hand has turned the held object about its hinge, in the direction of the step."""
    evaluation, query, held = task.evaluation, task.query, task.evaluation.held
    hinge = query.hinge(held)
    if hinge is None or not evaluation.start_joints or not task.report.tcp_pose:
        return 0.0
    tcps = (query.model.arms[evaluation.arm].fk(evaluation.start_joints), task.report.tcp_pose)
    home = query.hinge_home(held)
    start, end = (
        hinges.angle_of(home, hinge.axis, frame) for tcp in tcps if (frame := query.in_hand(held, tcp)) is not None
    )
    by_rad = task.step.by_rad if isinstance(task.step, CircleStep | MoveStep) else 0.0
    turn = math.copysign(1.0, by_rad) * (end - start)
    return (turn + BACK_RAD) % math.tau - BACK_RAD


def rolled(task: AnalyzeTask, changes: Changes) -> list[float] | None:
    """The spread of a held object with a hinge: it keeps its place, and a round bar rolls when its hand turns it."""
    thing, query = task.evaluation.held, task.query
    hinge = query.hinge(thing)
    if hinge is None:
        return None
    turned = next((change.value for change in changes if change.key == f"{thing}.frame"), None)
    spread = query.spread(f"{thing}.grasp")
    point = query.point_in_hand(thing)
    if turned is None or point is None or not point.round:
        return list(spread)
    lever_m = float(np.linalg.norm(np.cross(point.frame.xyz, hinge.axis)))
    rolled_m = 0.5 * point.width_m * geometry.angle(query.frame(thing), turned)
    return pose_spread.rolled_spread(spread, hinge.axis, rolled_m, task.values["rolled_m"], lever_m)


def angles(query: WorldQuery, changes: Changes) -> Changes:
    """The angle of each object with a hinge whose frame these changes state. It counts from the place of the hinge on
    the body that the object is mounted on."""
    found = []
    for change in changes:
        thing, _, attribute = change.key.rpartition(".")
        hinge = query.hinge(thing) if attribute == "frame" else None
        if hinge is None:
            continue
        home = query.after(changes).mount(query.cell.object(thing))
        angle = None if change.keep_value else hinges.angle_of(home, hinge.axis, change.value)
        found.append(msgspec.structs.replace(change, key=f"{thing}.angle", value=angle, spread=None))
    return found


# --- stated facts ------------------------------------------------------------------------------------------


def attributes(thing: parts.Object) -> Collection[str]:
    return ("angle",) if thing.hinge is not None else ()


def impossible(change: WorldChange, thing: parts.Object, query: WorldQuery) -> str:
    """Why an angle or a frame cannot be that of this object; empty if it can."""
    attribute = change.key.rpartition(".")[2]
    if thing.hinge is None or attribute not in ("angle", "frame"):
        return ""
    if attribute == "frame":
        return _off_hinge(thing, thing.hinge, change.value, query)
    if _is_between_stops(thing.hinge, change.value):
        return ""
    return f"{change.key} would be {math.degrees(change.value):.0f} deg; it turns {_stops(thing.hinge)}"


def refuse_off_hinge(thing: str, frame: Any, query: WorldQuery, _: Mapping[str, float]) -> Changes:
    """Raises Refused if an object with a hinge cannot be at this frame."""
    known = query.cell.object(thing) if query.hinge(thing) is not None else None
    if known is not None and known.hinge is not None and (off := _off_hinge(known, known.hinge, frame, query)):
        clears = f"SET {thing} ANGLE 0 DEG, or its angle; or its hinge in the cell file"
        raise Refused.because(RefusalReason.INFEASIBLE, off, where=f"{thing}.frame", clears=clears)
    return []


def _off_hinge(thing: parts.Object, hinge: parts.Hinge, frame: Any, query: WorldQuery) -> str:
    """Why an object cannot be at this frame; empty if it can. Its hinge is where the body that it is mounted on has it,
    up to an error of the survey."""
    home = query.mount(thing)
    angle = hinges.angle_of(home, hinge.axis, frame)
    place = hinges.turned(home, hinge.axis, angle)
    off_m, tilt_rad = geometry.distance(place, frame), geometry.angle(place, frame)
    if off_m > HINGE_OFF_M:
        return f"{thing.name} would be {off_m * 1000:.0f} mm from its hinge; {HINGE_OFF_M * 1000:.0f} mm is the most"
    if tilt_rad > HINGE_OFF_RAD:
        return f"{thing.name} would be tilted by {math.degrees(tilt_rad):.0f} deg against its hinge"
    if not _is_between_stops(hinge, angle):
        return f"{thing.name} would be at {math.degrees(angle):.0f} deg; it turns {_stops(hinge)}"
    return ""


def _is_between_stops(hinge: parts.Hinge, angle: float) -> bool:
    least, most = hinge.range_rad
    return least - HINGE_OFF_RAD <= angle <= most + HINGE_OFF_RAD


def _stops(hinge: parts.Hinge) -> str:
    least, most = hinge.range_rad
    return f"from {math.degrees(least):g} to {math.degrees(most):g} deg"

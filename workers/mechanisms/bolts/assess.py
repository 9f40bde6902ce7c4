"""What a turn of a driver, or a touch of a head, says about how far a bolt is out. Pure.

A turn is proved twice: by the spindle, and by the way of the hand along the thread, which the head moves. A driver that
has come off, and a stripped thread, turn without that way.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from rtc.model.cells import parts
from rtc.protocol.messages import TurnStep, Validity, WorldChange
from rtc.protocol.outcomes import StopReason
from rtc.protocol.units import figure
from rtc.spatial import geometry, hinges
from rtc.spatial.geometry import Array, Floats
from rtc.world.model import BOLT_STATES, LOOSE, TIGHT, TURNED
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import AnalyzeTask

SLACK_M, SLACK_SHARE = 0.0008, 0.05  # by which the way of the hand may differ from that of the thread
TORQUES = (StopReason.TORQUE_LIMIT, StopReason.CONTACT)  # reasons of a turn that a torque has ended
LEAST_TURNS = 0.02  # a smaller turn is none
SEATED_TURNS = 0.5  # a tight bolt is believed no farther out before its last turn ends
FREE_TURNS = 0.5  # the thread may end this far before its end is believed to be
ALONG = 0.7  # part of an axis along the spindle from which it counts as that of the spindle
WHOLE_TURN = 1e-6  # tolerance of stated turns
FELT_TURNS = 0.1  # accuracy of a touch of the head


def _thread(task: AnalyzeTask) -> parts.Thread:
    """That of the bolt of the command."""
    thread = task.query.thread(task.context.object)
    assert thread is not None
    return thread


def driven_turns(task: AnalyzeTask) -> float:
    """The turns of the spindle in this step, positive outwards."""
    return -(task.report.turned_rad or 0.0) / math.tau


def moved_turns(task: AnalyzeTask) -> float:
    """The turns that the way of the hand along the thread amounts to, positive outwards."""
    query, bolt = task.query, task.context.object
    thread, start, end = query.thread(bolt), task.evaluation.start_joints, task.report.trip_pose or task.report.tcp_pose
    if thread is None or not start or not end:
        return 0.0
    way = np.asarray(end[:3]) - query.model.arms[task.evaluation.arm].fk(start)[:3]
    return float(way @ geometry.rotate(query.frame(bolt), (0.0, 0.0, 1.0))) / thread.pitch_m


def is_unproved(task: AnalyzeTask) -> bool:
    """Whether the spindle has turned without the bolt."""
    thread = _thread(task)
    driven_m, moved_m = thread.pitch_m * driven_turns(task), thread.pitch_m * moved_turns(task)
    return abs(moved_m - driven_m) > SLACK_M + SLACK_SHARE * abs(driven_m)


def is_before_seat(task: AnalyzeTask) -> bool:
    """Whether the torque of a tight bolt was felt while the bolt was still out."""
    return task.query.turns(task.context.object) + driven_turns(task) > SEATED_TURNS


def has_come_free(task: AnalyzeTask) -> bool:
    """Whether the torque of the thread has ended where the thread does."""
    bolt = task.context.object
    thread = _thread(task)
    return task.query.turns(bolt) + driven_turns(task) > thread.turns - FREE_TURNS


def turned(task: AnalyzeTask, validity: Validity) -> list[WorldChange]:
    """The driver has turned the bolt: by what was commanded, or until it came free. A torque that was felt before it
    turned changes nothing."""
    if task.report.reason is StopReason.SLIP:
        return free(task, validity)
    if abs(driven_turns(task)) < LEAST_TURNS:
        return []
    turns = task.query.turns(task.context.object) + driven_turns(task)
    seated = task.report.reason in TORQUES and driven_turns(task) < 0.0 and turns < FELT_TURNS
    changes = _at(task, 0.0, validity, TIGHT) if seated else _at(task, turns, validity)
    return [*changes, *_on_head(task, validity)]


def tightened(task: AnalyzeTask, validity: Validity) -> list[WorldChange]:
    """The driver has turned the bolt in, until its torque was felt."""
    return [*_at(task, 0.0, validity, TIGHT), *_on_head(task, validity)]


def free(task: AnalyzeTask, validity: Validity) -> list[WorldChange]:
    """The driver turns the bolt outwards without the torque of a thread: it is out by all its turns."""
    thread = _thread(task)
    return [*_at(task, thread.turns, validity, LOOSE), *_on_head(task, validity)]


def wrong_turn(task: AnalyzeTask) -> str:
    """The spindle has turned without the bolt (`not_turned`), or a tight bolt was felt while it was out (`not_seated`).
    Empty: nothing is wrong."""
    if is_unproved(task) or (task.report.reason is StopReason.SLIP and not has_come_free(task)):
        return "not_turned"
    return "not_seated" if task.step.effect == "tightened" and is_before_seat(task) else ""


def wrong_head(task: AnalyzeTask) -> str:
    """The head stands where that of a loose bolt does not (`not_loose`); empty: nothing is wrong."""
    return "" if is_loose(task) else "not_loose"


def nothing_wrong(_: AnalyzeTask) -> str:
    """Nothing: a bolt that has come free is proved by the torque alone."""
    return ""


def left(task: AnalyzeTask) -> str | None:
    """The turns that are left of a sentence, as its amount; empty: none. None: the step turns no bolt."""
    step = task.step
    if not isinstance(step, TurnStep) or step.to_turns is None:
        return None
    turns = abs(step.to_turns - task.query.turns(task.context.object) - moved_turns(task))
    return f"{figure(turns)} TURNS" if turns > LEAST_TURNS else ""


def follows_from_state(thing: str, state: Any, query: WorldQuery, _: Mapping[str, float]) -> list[WorldChange]:
    """Turns and frame of a bolt in this state."""
    thread = query.thread(thing)
    if thread is None:
        return []
    turns = thread.turns if state == LOOSE else 0.0
    frame = geometry.normalise(query.turned_out(thing, turns)).tolist()
    return [WorldChange(key=f"{thing}.turns", value=turns), WorldChange(key=f"{thing}.frame", value=frame)]


def attributes(thing: parts.Object) -> Collection[str]:
    return ("turns",) if thing.thread is not None else ()


def impossible(change: WorldChange, thing: parts.Object, _: WorldQuery) -> str:
    """Why turns or a state cannot be those of this bolt; empty if they can."""
    attribute, thread = change.key.rpartition(".")[2], thing.thread
    if thread is None:
        return f"{thing.name} is no bolt, and has no state" if attribute == "state" else ""
    if attribute == "turns" and not -WHOLE_TURN <= change.value <= thread.turns + WHOLE_TURN:
        return f"{change.key} would be {change.value:g}; it has {thread.turns + WHOLE_TURN:g}"
    if attribute == "state" and change.value not in BOLT_STATES:
        return f"{change.key} is {change.value!s:.40}; a bolt is {', '.join(BOLT_STATES)}"
    return ""


def head_after_failure(task: AnalyzeTask, _: bool) -> list[WorldChange]:
    """A head that was touched is known."""
    return head_felt(task, Validity.VALID) if task.report.reason in task.step.expect else []


def after_failure(task: AnalyzeTask, retried: bool) -> list[WorldChange]:
    """The bolt, unless its turn is proved: it is believed where the way of the hand says, or a little farther in.

    A driver that has not felt the torque of the thread has turned nothing: it is seated again (`retried`). If it is
    not, the thread may be stripped: the state is in doubt. The place is not, where the operator turns the bolt by hand.
    """
    bolt, thread = task.context.object, _thread(task)
    complete = task.report.reason is StopReason.GOAL
    if abs(driven_turns(task)) < LEAST_TURNS:
        return []
    if complete and _felt_nm(task) < thread.running_nm:
        doubtful = [f"{bolt}.{name}" for name in ("turns", "state") if not retried]
        return [WorldChange(key=key, keep_value=True, validity=Validity.SUSPECT) for key in doubtful]
    if complete and is_proved(task):
        return turned(task, Validity.VALID)
    return _at(task, task.query.turns(task.context.object) + moved_turns(task) - FELT_TURNS, Validity.SUSPECT)


def _felt_nm(task: AnalyzeTask) -> float:
    """The torque at which the step would have ended; infinite without one."""
    return task.step.overrides.get("felt_nm", math.inf)


def head_felt(task: AnalyzeTask, validity: Validity) -> list[WorldChange]:
    """The driver was pressed on the head: the bolt is out by where the tip of its spindle is.

    Nothing changes if the bolt was believed to be there. Otherwise the new belief is FELT_TURNS farther in than felt:
    then a turn by what is left is sure to free the bolt. The belief is suspect if the driver's own pose is not known
    well enough."""
    query, bolt = task.query, task.context.object
    known = all(query.trusts(f"{bolt}.{name}") for name in ("turns", "state", "frame"))
    off, unsure = felt_turns(task) - query.turns(bolt), _unsure_turns(task)
    if known and abs(off) < 2.0 * FELT_TURNS + (unsure if is_loose(task) else 0.0):
        return []
    return _at(task, felt_turns(task) - FELT_TURNS, validity if unsure < FREE_TURNS else Validity.SUSPECT)


def _on_head(task: AnalyzeTask, validity: Validity) -> list[WorldChange]:
    """How the driver lies in the hand, if it has turned the bolt: its tip is on the head.

    A tip that should be too far from the axis is of a tilted driver. One that should be before the head, or in it, is
    of a driver that stands farther out of the hand, or less far."""
    query, tcp, tip = task.query, task.report.trip_pose or task.report.tcp_pose, _tip(task)
    if tip is None or not is_proved(task):
        return []
    thread = _thread(task)
    head = _head(task)
    x, y, z = geometry.relative(head, tip)[:3].tolist()
    tilts = math.hypot(x, y) > task.values["engaged_m"]
    shifts = abs(z) > FELT_TURNS * thread.pitch_m and _is_on_head(task, tip)
    if not tilts and not shifts:
        return []
    driver = query.holding(task.evaluation.arm)
    held = query.in_hand(driver, tcp)
    assert held is not None
    there = held
    if tilts:
        before = tip[:3] - np.asarray(tcp[:3])
        after = before - geometry.rotate(head, (x, y, 0.0))
        axis = np.cross(before, after)
        sine = float(np.linalg.norm(axis))
        pivot = geometry.make_pose(tcp[:3], (0.0, 0.0, 0.0, 1.0))
        tilted = hinges.turned(pivot, axis / sine, math.atan2(sine, float(before @ after)))
        there = geometry.compose(tilted, geometry.relative(pivot, held))
    if shifts:
        there = geometry.translate(there, geometry.rotate(head, (0.0, 0.0, -z)))
    grasp = geometry.relative(tcp, there)
    now = geometry.compose(task.report.tcp_pose, grasp)
    return [
        WorldChange(key=f"{driver}.grasp", value=geometry.normalise(grasp).tolist(), validity=validity),
        WorldChange(key=f"{driver}.frame", value=geometry.normalise(now).tolist(), validity=validity),
    ]


def _head(task: AnalyzeTask) -> Array:
    """The frame of the bolt after this turn."""
    query, bolt = task.query, task.context.object
    thread = _thread(task)
    turns = thread.turns if task.report.reason is StopReason.SLIP else query.turns(bolt) + driven_turns(task)
    return query.turned_out(bolt, min(max(0.0, turns), thread.turns))


def _is_on_head(task: AnalyzeTask, tip: Array) -> bool:
    """Whether the believed tip may be on the head that it has turned, as far as the driver is known along its axis."""
    along_m = abs(float(geometry.relative(_head(task), tip)[2]))
    return along_m <= max(task.values["engaged_m"], _unsure_along_m(task))


def _tip(task: AnalyzeTask) -> Array | None:
    """Pose of the tip of the spindle when the step ended, as believed (world); None if it is not known."""
    query, tcp = task.query, task.report.trip_pose or task.report.tcp_pose
    driver = query.driver(task.evaluation.arm)
    if driver is None or driver.spindle is None or not tcp or (grasp := query.grasp(driver.name)) is None:
        return None
    return geometry.compose(geometry.compose(tcp, grasp), driver.spindle.frame.pose)


def is_proved(task: AnalyzeTask) -> bool:
    """Whether this step has turned the bolt, so that the tip of the spindle is on its axis."""
    turns = task.report.turned_rad is not None and task.query.thread(task.context.object) is not None
    return turns and abs(driven_turns(task)) > LEAST_TURNS and not is_unproved(task)


def on_its_bolt(task: AnalyzeTask, spread: list[float]) -> list[float]:
    """The spread of a driver, in its own axes, after a step that may have turned a bolt. If it has, the driver is
    tilted by no more than its tip may be from the axis of the bolt. How far the torque has turned it about its spindle
    shows in the opening of the hand."""
    if not is_proved(task):
        return spread
    query, driver, tip = task.query, task.query.driver(task.evaluation.arm), _tip(task)
    if tip is None or driver is None or driver.spindle is None:
        return spread
    aside_m = math.hypot(*geometry.relative(query.frame(task.context.object), tip)[:2])
    off_m = min(aside_m, task.values["engaged_m"]) + task.values["engaged_m"] + max(spread[:3])
    tilt_rad = off_m / math.hypot(*driver.spindle.frame.xyz)
    along = np.abs(geometry.rotate(driver.spindle.frame.pose, (0.0, 0.0, 1.0)))
    angles = (had if part > ALONG else min(had, tilt_rad) for had, part in zip(spread[3:], along, strict=True))
    return [*spread[:3], *(float(angle) for angle in angles)]


def felt_turns(task: AnalyzeTask) -> float:
    """By how many turns the bolt is out, if the tip of the spindle is on its head."""
    bolt, tip = task.context.object, _tip(task)
    thread = task.query.thread(bolt)
    if thread is None or tip is None:
        return 0.0
    return float(geometry.relative(task.query.turned_out(bolt, 0.0), tip)[2]) / thread.pitch_m


def is_loose(task: AnalyzeTask) -> bool:
    """Whether the head that was touched is that of a loose bolt."""
    thread = task.query.thread(task.context.object)
    return thread is not None and felt_turns(task) > thread.turns - FREE_TURNS - min(_unsure_turns(task), FREE_TURNS)


def _unsure_turns(task: AnalyzeTask) -> float:
    """By how many turns a touch may be wrong."""
    thread = task.query.thread(task.context.object)
    return 0.0 if thread is None else _unsure_along_m(task) / thread.pitch_m


def _unsure_along_m(task: AnalyzeTask) -> float:
    """By how much the driver may stand farther out of the hand than believed, or less far."""
    query, driver = task.query, task.query.driver(task.evaluation.arm)
    if driver is None or driver.spindle is None:
        return 0.0
    along = np.abs(geometry.rotate(driver.spindle.frame.pose, (0.0, 0.0, 1.0)))
    return float(along @ query.spread(f"{driver.name}.grasp")[:3])


def in_words(task: AnalyzeTask) -> str:
    """How far the bolt is out: by the touch of its head, or by the way of the hand; empty without a bolt."""
    bolt = task.context.object
    thread = task.query.thread(bolt)
    if thread is None:
        return ""
    touched = task.step.effect == "head_felt"
    turns = felt_turns(task) if touched else task.query.turns(bolt) + moved_turns(task)
    return f"{bolt} is {max(0.0, turns) + 0.0:.1f} of {thread.turns:g} turns out"


def _at(task: AnalyzeTask, turns: float, validity: Validity, state: str = "") -> list[WorldChange]:
    """The facts of a bolt that is out by this many turns. `state`: if more is known than its turns say."""
    bolt, query = task.context.object, task.query
    thread = _thread(task)
    turns = min(max(0.0, turns), thread.turns)
    state = state or (LOOSE if turns > thread.turns - LEAST_TURNS else TURNED)
    frame: Floats = geometry.normalise(query.turned_out(bolt, turns)).tolist()
    return [
        WorldChange(key=f"{bolt}.turns", value=turns, validity=validity),
        WorldChange(key=f"{bolt}.state", value=state, validity=validity),
        WorldChange(key=f"{bolt}.frame", value=frame, validity=validity),
    ]

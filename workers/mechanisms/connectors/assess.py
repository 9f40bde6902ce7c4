"""What the way of a plug and the force on it say about its socket: whether the latch has clicked, and holds. Pure.

A click is proved twice: by the depth of the plug, and by the force, which falls when the latch snaps in. That the latch
holds is proved by a tug. The place of the plug is that of the hand that holds it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rtc.model.cells import parts
from rtc.protocol.messages import MoveStep, Validity, WorldChange
from rtc.protocol.outcomes import StopReason
from rtc.spatial.geometry import Array
from workers.mechanisms.connectors.state import FREE, MATED, STATES, plug, socket, state
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import AnalyzeTask, Changes

FELT_SHARE = 0.25  # of the force of the latch, by which the force falls when it clicks
HOME_SHARE = 0.6  # of the distance of the click from the mated place, within which a mated plug is


def clicked(task: AnalyzeTask, validity: Validity) -> Changes:
    """The plug is in its place in the socket. Whether the latch holds it is seen by the tug."""
    return [WorldChange(key=f"{_plug(task)}.seat", value=task.context.target, validity=validity), *_in_doubt(task)]


def latched(task: AnalyzeTask, validity: Validity) -> Changes:
    """The latch has borne the tug."""
    return [WorldChange(key=f"{_plug(task)}.mating", value=MATED, validity=validity)]


def demated(task: AnalyzeTask, validity: Validity) -> Changes:
    """The plug is out of the reach of the latch."""
    return [WorldChange(key=f"{_plug(task)}.mating", value=FREE, validity=validity)]


def not_clicked(task: AnalyzeTask) -> str:
    """The plug is short of its place, or the force on it has not fallen by a click."""
    mating, out_m = _mating(task), _out_m(task)
    if mating is None or out_m is None or out_m > HOME_SHARE * mating.click_m:
        return "not_home"
    return "" if _fall_n(task) >= FELT_SHARE * mating.latch_n else "no_click"


def not_out(task: AnalyzeTask) -> str:
    """The plug is still between the contacts."""
    mating, out_m = _mating(task), _out_m(task)
    return "held_in" if mating is not None and out_m is not None and out_m < mating.depth_m else ""


def interrupted(task: AnalyzeTask) -> Changes:
    """A step has ended otherwise: a plug that the latch cannot reach is free, and so is one that has followed a tug.
    Whether the latch holds any other one is in doubt."""
    mating, out_m = _mating(task), _out_m(task)
    if mating is None or out_m is None:
        return _in_doubt(task) if _plug(task) else []
    if out_m > mating.latch_m or (task.step.effect == "latched" and task.report.reason is StopReason.GOAL):
        return demated(task, Validity.VALID)
    return _in_doubt(task)


def in_words(task: AnalyzeTask) -> str:
    """Where a plug is on its way in or out; empty for what is no plug."""
    mating, out_m = _mating(task), _out_m(task)
    if mating is None or out_m is None:
        return ""
    where = f"{_plug(task)} is {max(0.0, 1000 * out_m):.0f} mm before its mated place"
    ended = task.step.effect == "clicked" and task.report.reason is StopReason.GOAL
    return f"{where}; the force has fallen by {max(0.0, _fall_n(task)):.1f} N" if ended else where


# --- stated facts ------------------------------------------------------------------------------------------


def stated(thing: str, value: Any, query: WorldQuery, _: Mapping[str, float]) -> Changes:
    """A plug that is stated to be mated is in the place of the socket around it."""
    seat = socket(query, thing) if value == MATED and plug(query, thing) is not None else None
    if seat is None or query.held_by(thing):
        return []
    return [
        WorldChange(key=f"{thing}.seat", value=seat.name),
        WorldChange(key=f"{thing}.frame", value=query.seated_pose(seat.name).tolist()),
    ]


def placed(thing: str, frame: Any, query: WorldQuery, _: Mapping[str, float]) -> Changes:
    """A plug that is stated to be elsewhere is free there; whether one in a socket is mated is not known."""
    if plug(query, thing) is None:
        return []
    seat = socket(query, thing, frame)
    if seat is None:
        return [WorldChange(key=f"{thing}.mating", value=FREE)]
    same = socket(query, thing) == seat and state(query, thing) == MATED
    return [] if same else [WorldChange(key=f"{thing}.mating", value=FREE, validity=Validity.SUSPECT)]


def impossible(change: WorldChange, thing: parts.Object, query: WorldQuery) -> str:
    """Why a plug cannot be mated or free, as stated; empty if it can."""
    if change.key.rpartition(".")[2] != "mating":
        return ""
    if thing.plug is None:
        return f"{thing.name} is no plug: it is neither mated nor free"
    if change.value not in STATES:
        return f"{change.key} is {change.value!s:.40}; a plug is {' or '.join(STATES)}"
    if change.value == MATED and socket(query, thing.name) is None:
        return f"{thing.name} would be mated, and is in no socket"
    return ""


# --- one report --------------------------------------------------------------------------------------------


def _plug(task: AnalyzeTask) -> str:
    return task.evaluation.held or task.context.object


def _frame(task: AnalyzeTask) -> Array | None:
    """Where the hand has the plug at the end of the step (world)."""
    return task.query.in_hand(_plug(task), task.report.tcp_pose) if task.report.tcp_pose else None


def _socket(task: AnalyzeTask) -> parts.Seat | None:
    """The socket of the sentence, or that in which the plug was when the step began."""
    if task.context.target:
        return task.query.cell.seat(task.context.target)
    return socket(task.query, _plug(task)) if plug(task.query, _plug(task)) is not None else None


def _mating(task: AnalyzeTask) -> parts.Mating | None:
    seat = _socket(task)
    return seat.mating if seat is not None else None


def _out_m(task: AnalyzeTask) -> float | None:
    """How far the plug is from its mated place, along the way out."""
    seat, frame = _socket(task), _frame(task)
    return None if seat is None or frame is None else task.query.out_m(seat.name, frame)


def _fall_n(task: AnalyzeTask) -> float:
    """By how much the force was smaller at the end of the path than its peak. A compliant hand unloads after that; its
    spring was stretched until then by how far it is from its goal."""
    own_n_m = task.step.of_kind(MoveStep).stiffness_n_m
    stretched_n = (task.context.limits.stiffness_n_m or own_n_m) * task.off_m if own_n_m is not None else 0.0
    return task.report.peak_force_n - max(stretched_n, math.hypot(*task.report.wrench[:3]))


def _in_doubt(task: AnalyzeTask) -> Changes:
    key = f"{_plug(task)}.mating"
    return [WorldChange(key=key, value=state(task.query, _plug(task)), validity=Validity.SUSPECT)]

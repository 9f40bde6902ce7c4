"""Who times a path: the timings of the program, one after the other. Pure if they are.

    function(arm: ArmModel, path: Path, pace: SpeedLimits, load: Load | None) -> Timed, or None

A timing of a package (`rtc.timing`) is slowed to the limits of the arm, and refused if it is not one of the path.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rtc.model.robot.kinematics import ArmModel
from rtc.plugins import registry
from rtc.programs.named_algorithms import acted
from rtc.programs.schema import OWN
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.spatial.geometry import Array
from workers.planning.motion import timing
from workers.planning.motion.path import Path
from workers.planning.motion.request import PlanningRequest
from workers.planning.motion.timing import Timed, slowed, slower
from workers.planning.motion.torques import Torques

ON_PATH = 2000  # points of the path with which the timing of a package is compared
ADDED_KNOTS, BETWEEN_KNOTS = 10_000, 4  # that it may have; intervals of a piece in which its speed is looked at
LEAST_S = 1e-6  # between its knots
END_RAD = 1e-6  # tolerance of its ends, also rad/s and rad/s^2


def time_path(request: PlanningRequest, path: Path) -> tuple[Timed, tuple[str, ...]]:
    """The path, timed at the pace of the request by the first timing that does; and which one, if there is a choice.

    Raises Refused if the arm cannot hold the load against gravity everywhere on the path."""
    timings = request.algorithms.timing
    for name in timings:
        if name == OWN or path.is_a_point:
            timed = timing.time_path(request.arm, path, request.pace, request.load)
        elif (added := _of_package(name, request, path)) is not None:
            timed = slower(added, math.sqrt(max(1.0, Torques.of(request.arm, request.load).excess(added.sampled))))
        else:
            continue
        return timed, acted(registry.TIMING, name, timings)
    message, clears = f"not timed by {', '.join(timings)}", by_person(f"a program whose `timing` names {OWN} too")
    raise Refused.because(RefusalReason.INFEASIBLE, message, clears=clears)


def _of_package(name: str, request: PlanningRequest, path: Path) -> Timed | None:
    """Its timing, slowed to the limits of the arm; None: it leaves the path to the next one.

    Raises Refused if its knots are not on the path from end to end, or it is faster than the pace."""
    arm, pace = request.arm, request.pace
    with registry.guarded(registry.TIMING, name):
        answer = registry.installed(registry.TIMING)[name](arm, path, pace, request.load)
        timed = _converted(answer, len(arm.limits.lower))
    if timed is None:
        return None
    fine = path.at(np.linspace(0.0, path.length, ON_PATH))[0]
    off = max(float(np.abs(fine - q).max(axis=1).min()) for q in (*timed.positions, *_midway(timed)))
    ends = np.abs(timed.positions[[0, -1]] - path.knots[[0, -1]]).max()
    rests = max(np.abs(timed.velocities[[0, -1]]).max(), np.abs(timed.accelerations[[0, -1]]).max())
    speed_m_s = _fastest_m_s(arm, timed)
    step_rad = float(np.abs(np.diff(fine, axis=0)).max())
    right = off <= step_rad and max(ends, rests) <= END_RAD and speed_m_s <= pace.speed_m_s + 1e-6
    if not right:  # false for nan too
        words = f"{off:.3g} rad off the path, ends {ends:.3g} rad off, tcp speed {speed_m_s:.3g} m/s"
        message, clears = f"the timing {name} is not one of this path: {words}", f"a program without {name} in `timing`"
        raise Refused.because(RefusalReason.INFEASIBLE, message, clears=by_person(clears))
    return slowed(arm, timed)


def _converted(answer: Any, dof: int) -> Timed | None:
    """What a package has returned, as arrays of the right shapes. Raises ValueError and others."""
    if answer is None:
        return None
    if answer.space not in ("joint", "task"):
        raise ValueError("its space is neither joint nor task")
    parts = (answer.time_s, answer.positions, answer.velocities, answer.accelerations)
    time_s, *rows = (np.array(part, dtype=float) for part in parts)
    knots = time_s.size
    if not 2 <= knots <= ADDED_KNOTS or time_s.ndim != 1 or any(row.shape != (knots, dof) for row in rows):
        raise ValueError(f"expected are 2 to {ADDED_KNOTS} knots of {dof} joints")
    if (
        not all(np.isfinite(part).all() for part in (time_s, *rows))
        or time_s[0] != 0.0
        or np.diff(time_s).min() < LEAST_S
    ):
        raise ValueError("expected are finite figures, at times that begin with 0 and rise")
    return Timed(answer.space, time_s, *rows)


def _fastest_m_s(arm: ArmModel, timed: Timed) -> float:
    """Greatest speed of the tcp at the knots and between them: velocities and times need not fit each other."""
    knots = len(timed.time_s)
    index = np.arange(BETWEEN_KNOTS * (knots - 1) + 1) / BETWEEN_KNOTS
    found = timed.at(np.interp(index, np.arange(knots), timed.time_s))
    return float(arm.tcp_speeds(found[:, 0], found[:, 1]).max())


def _midway(timed: Timed) -> Array:
    """The postures in the middle between two knots, [knots - 1][joints]."""
    h = np.diff(timed.time_s)[:, None]
    q, v, a = timed.positions, timed.velocities, timed.accelerations
    middle: Array = 0.5 * (q[:-1] + q[1:]) + 5 / 32 * h * (v[:-1] - v[1:]) + h * h / 64 * (a[:-1] + a[1:])
    return middle

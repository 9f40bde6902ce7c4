"""Inverse kinematics: the postures of a pose by the solvers of the program, and the choice among them. Pure.

    function(arm: ArmModel, target: Array, near: Array) -> joint values (rad) of postures     a solver of a package

A posture of a package (`rtc.ik`) counts if it reaches the pose within the limits. If no posture passes, the refusal
states the problem of the nearest one and the number of those tried.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from rtc.model.robot.kinematics import ArmModel
from rtc.plugins import registry
from rtc.programs.named_algorithms import acted
from rtc.programs.schema import OWN
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused
from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats

ADDED_POSTURES = 64  # of the solver of a package, for one pose
REACHED_M, REACHED_RAD = 1e-4, 1e-3  # tolerance of such a posture

Test = Callable[[Array], Refusal | None]


class Postures(NamedTuple):
    found: list[Array]  # rad, the nearest one first
    notes: tuple[str, ...] = ()  # which solver has found them, if the program leaves a choice


class Posture(NamedTuple):
    joints: Array  # rad
    notes: tuple[str, ...] = ()


def solutions(
    solvers: Sequence[str], arm: ArmModel, target: Floats, near: Floats | None = None, margin_rad: float = 0.0
) -> Postures:
    """Postures for the tcp pose `target` (world), of the first of `solvers` that finds any; as `ArmModel.ik`."""
    for name in solvers:
        found = arm.ik(target, near, margin_rad) if name == OWN else _of_package(name, arm, target, near, margin_rad)
        if found:
            return Postures(found, acted(registry.IK, name, solvers))
    return Postures([])


def why_none(solvers: Sequence[str], arm: ArmModel, target: Floats, margin_rad: float = 0.0) -> Refusal:
    """The refusal of a pose for which these solvers find no posture."""
    message = f"no posture of {arm.name} was found for the pose, by {', '.join(solvers)}"
    clears = by_person(f"a program whose `ik` names {OWN} too")
    unsolved = Refusal(reason=RefusalReason.INFEASIBLE, message=message, clears=clears)
    return arm.why_no_ik(target, margin_rad) or unsolved


def choose(
    arm: ArmModel,
    target: Floats,
    near: Floats,
    *,
    test: Test | None = None,
    margin_rad: float = 0.0,
    solvers: Sequence[str] = (OWN,),
) -> Posture:
    """The posture for the tcp pose `target` (world) that is nearest to `near` (rad).

    `test`: further condition, such as no collision; returns the refusal if it fails. Raises Refused.
    """
    first: Refusal | None = None
    candidates = solutions(solvers, arm, target, near, margin_rad)
    for joints in candidates.found:
        problem = test(joints) if test is not None else None
        if problem is None:
            return Posture(joints, candidates.notes)
        first = first or problem
    if first is None:
        raise Refused(why_none(solvers, arm, target, margin_rad))
    raise Refused(first.after(branches_tried=len(candidates.found)))


def _of_package(name: str, arm: ArmModel, target: Floats, near: Floats | None, margin_rad: float) -> list[Array]:
    """Its postures, as far as they reach the target within the limits. Raises PluginError."""
    reference = np.array(arm.middle if near is None else near, dtype=float)
    with registry.guarded(registry.IK, name):
        answer = registry.installed(registry.IK)[name](arm, np.array(target, dtype=float), reference.copy())
        postures = [np.array(raw, dtype=float) for raw in itertools.islice(answer, ADDED_POSTURES)]
    shaped = [q for q in postures if q.shape == reference.shape and np.isfinite(q).all()]
    return [q for q in shaped if arm.limit_margin_rad(q) >= margin_rad and _reaches(arm, q, target)]


def _reaches(arm: ArmModel, q: Array, target: Floats) -> bool:
    pose = arm.fk(q)
    return geometry.distance(pose, target) <= REACHED_M and geometry.angle(pose, target) <= REACHED_RAD

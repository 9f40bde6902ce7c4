"""Seeded planning queries of a cell: free start and free goal of one arm, with and without an object in its hand.

Half of the goals are poses near a seat, with about the first attitude of the cell; half are any free posture. Starts
are the goal before, or a point on the way to it, where a halt may have left the arm. The other arms rest at home or
anywhere free.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from rtc.model.cells import parts
from rtc.model.robot.collision_scene import Held, Scene
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.planning.motion import path as paths
from workers.planning.motion.constraints import FREE, PathConstraints
from workers.planning.motion.request import PlanningRequest, fault, free_posture
from workers.planning.robot_models import CellModel
from workers.planning.scenes import CLEARANCE_M

TRIES = 2000  # maximum number of samples for one free posture
OFF_M, OFF_RAD = (0.45, 0.30, 0.25), 0.5  # range of a goal near a seat: along and across its way in, and attitude
FINGERS_M = 0.02  # opening of a hand that holds an object


@dataclass(frozen=True, eq=False)
class Query:
    """`request` holds the start and the scene; `goals` are the free postures (rad) at one pose, the nearest first."""

    request: PlanningRequest
    goals: list[Array]
    kind: str  # such as "empty hand, near a seat"

    @property
    def goal(self) -> Array:
        return self.goals[0]


class Queries:
    """An endless stream of queries for one arm of a cell."""

    def __init__(self, model: CellModel, arm: str, seed: int, attitude: str = "") -> None:
        """`attitude`: kept by start and goal, and by the motion; goals are near seats then."""
        self._attitude = model.cell.attitudes[attitude] if attitude else None
        self._model, self._cell = model, model.cell
        self._arm = model.arms[arm]
        self._rng = np.random.default_rng((seed, len(arm), ord(arm[0])))
        self._margin_rad = math.radians(self._cell.numbers.joint_margin_deg)
        self._things = [thing for thing in self._cell.objects if not thing.fixed and thing.grasp_points]

    def take(self, count: int) -> Iterator[Query]:
        """`count` queries; blocks of ten share the object in the hand and the places of the other arms."""
        while True:
            request, holds = self._block()
            for _ in range(10):
                made = self._query(request, holds)
                yield made
                count -= 1
                if count == 0:
                    return
                request = self._next_start(made)

    def _block(self) -> tuple[PlanningRequest, str]:
        """A scene in which all arms are free, and what this arm holds."""
        holds = self._things[self._rng.integers(len(self._things))] if self._rng.random() < 0.5 else None
        scene = Scene(moving=self._arm.name, clearance_m=CLEARANCE_M)
        rules = FREE if self._attitude is None else PathConstraints(attitude=self._attitude, attitude_name="kept")
        if holds is not None:
            point = holds.grasp_points[self._rng.integers(len(holds.grasp_points))]
            grasp = geometry.inverse(point.frame.pose)
            scene = replace(
                scene, held={holds.name: Held(self._arm.name, grasp)}, openings_m={self._arm.name: FINGERS_M}
            )
        joints = {arm.name: np.array(arm.home_rad) for arm in self._cell.arms}
        request = PlanningRequest(self._arm, self._model.collision, joints, scene, rules, margin_rad=self._margin_rad)
        joints[self._arm.name] = self._goals(request, near_seat=self._attitude is not None)[0]
        for other in self._cell.arms:
            if other.name != self._arm.name:
                joints[other.name] = self._at_rest(replace(request, arm=self._model.arms[other.name]))
        return replace(request, joints=joints), "laden hand" if holds else "empty hand"

    def _at_rest(self, request: PlanningRequest) -> Array:
        """Where another arm may rest (rad): at home, stowed, at one of its places, or anywhere free."""
        arm = self._cell.arm(request.arm.name)
        request = replace(request, scene=replace(request.scene, moving=arm.name), path_constraints=FREE)
        drawn, test = self._rng.random(), free_posture(request)
        places = [place.poses[arm.name].pose for place in self._cell.places if arm.name in place.poses]
        usual = [np.array(arm.home_rad), np.array(arm.stow_rad)]
        usual += [q for pose in places for q in request.arm.ik(pose, arm.home_rad, self._margin_rad)[:1]]
        first = 0 if drawn < 0.5 else int(self._rng.integers(len(usual)))
        for q in usual[first:] if drawn < 0.9 else []:
            if test(q) is None:
                return q
        return self._free(request)

    def _free(self, request: PlanningRequest) -> Array:
        lower, upper = request.arm.limits.lower + self._margin_rad, request.arm.limits.upper - self._margin_rad
        test = free_posture(request)
        for _ in range(TRIES):
            q = self._rng.uniform(lower, upper)
            if test(q) is None:
                return q
        raise AssertionError(f"{request.arm.name}: {TRIES} samples, and none is free")

    def _query(self, request: PlanningRequest, holds: str) -> Query:
        near_seat = self._attitude is not None or self._rng.random() < 0.5
        return Query(request, self._goals(request, near_seat), f"{holds}, {'near a seat' if near_seat else 'anywhere'}")

    def _goals(self, request: PlanningRequest, near_seat: bool) -> list[Array]:
        """The free postures at a pose, the nearest first."""
        test = free_posture(request)
        for _ in range(TRIES):
            pose = self._near_a_seat() if near_seat else request.arm.fk(self._free(request))
            found = [q for q in request.arm.ik(pose, request.start, self._margin_rad) if test(q) is None]
            if found:
                return found
        raise AssertionError(f"{request.arm.name}: {TRIES} poses, and none is free")

    def _near_a_seat(self) -> Array:
        seat: parts.Seat = self._cell.seats[self._rng.integers(len(self._cell.seats))]
        way_in = next(iter(self._cell.attitudes.values())).pose  # of the tool
        level = geometry.make_pose(seat.frame.pose[:3], way_in[3:])
        back, aside, up = self._rng.uniform((-OFF_M[0], -OFF_M[1], -OFF_M[2]), (0.0, OFF_M[1], OFF_M[2])).tolist()
        off = geometry.rotate(level, (-up, aside, back))
        turn = self._rng.normal(size=3)
        turn *= self._rng.uniform(0.0, OFF_RAD) / np.linalg.norm(turn)
        turned = geometry.compose(level, geometry.from_rpy((0.0, 0.0, 0.0), turn)) if self._attitude is None else level
        return geometry.translate(turned, off)

    def _next_start(self, made: Query) -> PlanningRequest:
        """The goal as the next start; or a point on the way to it, as after a halt."""
        start = made.goal
        line = paths.joint_line(made.request.start, made.goal)
        if self._rng.random() < 0.3 and fault(made.request, line) is None:
            start = line.joints_at(np.array([self._rng.uniform(0.1, 0.9)]))[0]
        return replace(made.request, joints={**made.request.joints, self._arm.name: start})

"""Peer of `benchmarks.planning`: OMPL's RRT-Connect with a collision checker in Python.

As in most projects that plan for pybullet: a validity callback sets the joints, and pybullet detects collisions. Edges
are divided by OMPL. The same search over the checks of `rtc.model.robot.collision` is the reference of what can be
reached. Needs ompl 2 (`pip install -e ".[bench]"`).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pybullet
from ompl import base, geometric, util

from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from sim_mcm.arms.bullet_world import PhysicsWorld
from workers.planning.motion.path import CHECK_RAD
from workers.planning.motion.request import PlanningRequest, free_posture
from workers.planning.robot_models import CellModel

SIMPLIFY_S = 0.05  # time for OMPL's simplification of a path; more than most need
util.setLogLevel(util.LogLevel.LOG_ERROR)


class BulletCell:
    """The cell in pybullet as a collision checker. Contacts of an arm with itself are not tested."""

    def __init__(self, model: CellModel) -> None:
        self._world = PhysicsWorld(model.cell)
        self._cell = model.cell
        self._bodies = {arm.name: self._world.load_arm(arm.name) for arm in model.cell.arms}
        self._joints, self._fingers = {}, {}
        for name, body in self._bodies.items():
            count = pybullet.getNumJoints(body, physicsClientId=self._world.client)
            rows = [pybullet.getJointInfo(body, n, physicsClientId=self._world.client) for n in range(count)]
            numbers = {row[1].decode(): row[0] for row in rows}
            self._joints[name] = [numbers[joint] for joint in model.cell.arm(name).joints]
            self._fingers[name] = [numbers[joint] for joint in model.cell.arm(name).gripper.finger_joints]

    def close(self) -> None:
        self._world.close()

    def test(self, request: PlanningRequest) -> Callable[[Array], bool]:
        """Set the scene of a request; the function tests postures of its arm (rad)."""
        for name, body in self._world.objects.items():
            if name not in request.scene.held:
                self._world.place(body, request.scene.poses.get(name, self._cell.object_pose(name)))
        for name, body in self._bodies.items():
            width = request.scene.openings_m.get(name, self._cell.arm(name).gripper.max_opening_m)
            for joint, q in zip(self._joints[name], request.joints[name], strict=True):
                self._set(body, joint, float(q))
            for finger in self._fingers[name]:
                self._set(body, finger, 0.5 * width)
        moving = self._bodies[request.arm.name]
        held = {name: thing.pose for name, thing in request.scene.held.items()}
        carried = {part for name in held for part, _ in self._world.objects[name].parts}

        def free(q: Array) -> bool:
            client = self._world.client
            for joint, value in zip(self._joints[request.arm.name], q, strict=True):
                pybullet.resetJointState(moving, joint, value, physicsClientId=client)
            if held:
                hand = request.arm.fk(q)
                for name, grasp in held.items():
                    self._world.place(self._world.objects[name], geometry.compose(hand, grasp))
            pybullet.performCollisionDetection(physicsClientId=client)
            return not any(
                contact[8] < 0 and contact[2] != moving and contact[2] not in carried
                for body in (moving, *carried)
                for contact in pybullet.getContactPoints(bodyA=body, physicsClientId=client)
            )

        return free

    def _set(self, body: int, joint: int, value: float) -> None:
        pybullet.resetJointState(body, joint, value, physicsClientId=self._world.client)


def plan(request: PlanningRequest, goal: Array, free: Callable[[Array], bool], limit_s: float) -> list[Array] | None:
    """Way-points (rad) from the start to the goal, simplified; None: not found in `limit_s`."""
    count = len(goal)
    space = base.RealVectorStateSpace(count)
    bounds = base.RealVectorBounds(count)
    lower, upper = request.arm.limits.lower, request.arm.limits.upper
    for n in range(count):
        bounds.setLow(n, float(lower[n]))
        bounds.setHigh(n, float(upper[n]))
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    information = setup.getSpaceInformation()

    class Checker(base.StateValidityChecker):
        def isValid(self, state: base.State) -> bool:
            return free(np.array(state[0:count]))

    checker = Checker(information)
    setup.setStateValidityChecker(checker)
    # OMPL measures by the Euclidean distance; ours by joint, so its steps are no shorter than ours.
    information.setStateValidityCheckingResolution(CHECK_RAD * math.sqrt(count) / space.getMaximumExtent())
    start, end = space.allocState(), space.allocState()
    for n in range(count):
        start[n], end[n] = float(request.start[n]), float(goal[n])
    setup.setStartAndGoalStates(start, end)
    setup.setPlanner(geometric.RRTConnect(information))
    setup.solve(limit_s)
    if not setup.haveExactSolutionPath():
        return None
    setup.simplifySolution(SIMPLIFY_S)
    path = setup.getSolutionPath()
    return [np.array(path.getState(n)[0:count]) for n in range(path.getStateCount())]


def reference(request: PlanningRequest) -> Callable[[Array], bool]:
    """The checks of `rtc.model.robot.collision` for `plan`."""
    test = free_posture(request)
    return lambda q: test(q) is None

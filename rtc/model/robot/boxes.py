"""Boxes around the pieces of a cell, which prove that pairs of pieces are apart (decision 0069).

The proof is compiled (`_boxes.cpp`): a direction that separates two boxes by more than the margin. It is prepared here
from pinocchio's model and coal's solids, so there is no second robot model. What it leaves undecided coal decides.
Without a compiler, or for a joint that it does not know, there are no boxes, and coal decides everything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from rtc.model.robot import compiled, puma_ik
from rtc.model.robot.bodies import Bodies
from rtc.spatial.geometry import Array

if compiled():
    from rtc.model.robot import _boxes
else:
    _boxes = None  # type: ignore[assignment]

#: both passes of a curve's timing, compiled; None: `workers.planning.motion.pace` makes them
squared_pace = None if _boxes is None else _boxes.squared_pace

KINDS = ("JointModelRX", "JointModelRY", "JointModelRZ", "JointModelRevoluteU", "JointModelP")  # one value each
STEP_M = 0.03  # greatest displacement of a piece between two configurations of which its space is made
STRAIGHT: Array = np.empty((0, 0))  # a way along the lines between its rows
HALVINGS = 7  # of a line between two configurations of a path; what is undecided then is measured


class Growth(NamedTuple):
    """Figures of a search by two trees; a length is the greatest weighted displacement of a joint (rad)."""

    reach: float  # maximum length of an extension
    least: float  # minimum length of an extension
    back: float  # share of the free part of a blocked line after which its node is set
    vain: float  # factor of the squared distance of a node from which a tree could not grow
    projected: float  # length of a step between two projections
    onward: float  # share of its length that a projected step must make towards its end


class Projection(NamedTuple):
    """An attitude that the tip of an arm keeps, and the figures of the steps to it."""

    arm: _boxes.Arm | None
    attitude: Array  # [9], in the axes of the arm's base; empty: none
    steps: int  # maximum number
    tolerance: float  # rad
    damping: float


class Boxes:
    """The boxes of a cell's pieces and the pairs in force. Not thread-safe."""

    def __init__(self, bodies: Bodies, levers: Array, joints: Sequence[tuple[int, bool, Array, list[float]]]) -> None:
        """`levers`: [pieces][values of the configuration], kept and read by `place`. `joints`: parent (-1: the world),
        whether it slides, axis, placement (rotation row by row, position)."""
        items = bodies.geometry.geometryObjects
        solids = [item.geometry for item in items]
        for solid in solids:
            solid.computeLocalAABB()
        of_centres = [pin.SE3(np.eye(3), np.asarray(solid.aabb_center)) for solid in solids]
        in_owner = (piece.in_owner * centre for piece, centre in zip(bodies.pieces, of_centres, strict=True))
        self._in_owner, self._levers = np.array([at.homogeneous for at in in_owner]), levers
        parents, slides, axes, placements = zip(*joints, strict=True)
        pairs = np.array(bodies.pairs, dtype=np.int32).reshape(-1, 2)
        made, hulls = zip(*(_solid(solid) for solid in solids), strict=True)
        self._proof = _boxes.Boxes(parents, slides, axes, placements, pairs, np.array(made), hulls)
        for n, (item, piece) in enumerate(zip(items, bodies.pieces, strict=True)):
            self.place([n], item.parentJoint, item.placement * piece.in_owner.inverse())

    def place(self, pieces: list[int], parent: int, at: pin.SE3) -> None:
        """Place the pieces of an owner, whose axes are at `at` in those of a joint of pinocchio (0: the world). Their
        levers must be set."""
        self._proof.place(pieces, parent - 1, at.homogeneous, self._in_owner[pieces], self._levers[pieces])

    def use(self, pairs: Array, margins: Array) -> None:
        """The pairs to check, by number in `Bodies.pairs`, and their margins (m)."""
        self._proof.use(pairs, margins)

    def undecided(self, q: Array, slots: list[int]) -> list[int]:
        """The pairs that are not certainly farther apart than their margins at this configuration.

        `slots`: its values that vary between one call and the next; it is quicker if the others do not."""
        return self._proof.undecided(q, slots)

    def way(self, q: Array, slots: list[int], rows: Array, first: int, off: Array = STRAIGHT) -> tuple[int, list[int]]:
        """The first part of a way that is not proven free: the number of the row before it, and its undecided pairs.

        Without such a part: the number of the last row, and no pair. `rows`: values of the configuration at `slots`,
        [n][slots], of which the way begins at the row `first`; the other values are those of `q`. `off`: how far the
        way may be off the straight line between two rows, [n - 1][slots]; or empty. A line between two rows is halved
        `HALVINGS` times before it counts as undecided.
        """
        return self._proof.way(q, slots, rows, first, HALVINGS, off)

    def line(self, q: Array, slots: list[int], start: Array, end: Array, steps: int) -> tuple[int, list[int]]:
        """As `way`, of the straight line between two values at `slots` in equal steps."""
        return self._proof.line(q, slots, start, end, steps, HALVINGS)

    def trees(
        self,
        q: Array,
        slots: list[int],
        goals: Sequence[Array],
        limits: Array,
        weights: Array,
        growth: Growth,
        projection: Projection,
    ) -> _boxes.Trees | None:
        """Trees from `q` and from these goals, for a search while the scene stays; None: an end is not proven free.

        `limits` [2][slots]. `weights` [2][slots]: of a joint in distances; steps of a collision check per rad."""
        arm, attitude, steps, tolerance, damping = projection
        if attitude.size and arm is None:
            return None
        figures = _boxes.Growth(*growth, tolerance, damping, steps, HALVINGS)
        ends = q[slots], np.array(goals)
        made = _boxes.Trees(self._proof, q, slots, *ends, limits, weights, figures, arm, attitude)
        return made if made.ends_are_free() else None

    def separation(
        self, q: Array, pairs: Array, slots: tuple[list[int], list[int]], ways: tuple[Array, Array], clearance_m: float
    ) -> _boxes.Separation:
        """The proof that two ways stay apart, while no body is placed anew. `pairs`: [pairs][2] pieces of either way.
        `ways`: values of the configuration at the `slots` of each; the other values are those of `q`."""
        return _boxes.Separation(self._proof, q, pairs, slots[0], ways[0], slots[1], ways[1], clearance_m)

    def space(self, q: Array, slots: list[int], rows: Array, pieces: list[int]) -> Array:
        """Boxes in the axes of the world around these pieces on a way, [pieces][6]: low corner, high corner (m).

        `q`, `slots` and `rows` as for `way`."""
        found: Array = self._proof.space(q, slots, rows, pieces, STEP_M)
        return found


def _solid(solid: coal.CollisionGeometry) -> tuple[list[float], list[float]]:
    """A solid as the kernel takes it: eight numbers in m, and the corners of a hull.

    - 0 to 2: half edges of its bounding box
    - 3 to 5: half edges of its core, a box, which a disk (6: radius, in x and y) and a ball (7: radius) are swept over.
      A sphere is a point and a ball, a capsule a line and a ball, a cylinder a line and a disk

    The corners are relative to the centre of the bounding box."""
    centre = np.asarray(solid.aabb_center)
    around = (np.asarray(solid.aabb_local.max_) - centre).tolist()
    corners: list[float] = []
    if isinstance(solid, coal.Sphere):
        own = [0.0, 0.0, 0.0, 0.0, solid.radius]
    elif isinstance(solid, coal.Capsule):
        own = [0.0, 0.0, solid.halfLength, 0.0, solid.radius]
    elif isinstance(solid, coal.Cylinder):
        own = [0.0, 0.0, solid.halfLength, solid.radius, 0.0]
    else:
        own = [*around, 0.0, 0.0]
    if isinstance(solid, coal.Convex):
        corners = (np.asarray(solid.points()) - centre).ravel().tolist()
    return around + own, corners


def boxes_of(bodies: Bodies, levers: Array) -> Boxes | None:
    """Boxes in the initial state of a cell; None where coal decides everything. `levers`: as for `Boxes`."""
    joints = _joints_of(bodies.model)
    return Boxes(bodies, levers, joints) if joints else None


def arm_of(model: pin.Model, tip: pin.Frame) -> _boxes.Arm | None:
    """The kinematics of an arm alone, compiled; None where pinocchio does it all. `tip`: on its last joint."""
    joints = _joints_of(model)
    if not joints:
        return None
    parents, slides, axes, placements = zip(*joints, strict=True)
    return _boxes.Arm(parents, slides, axes, placements, [*tip.placement.rotation.flat, *tip.placement.translation])


def puma_of(lengths: puma_ik.PumaGeometry, base: Array, tool: Array, speeds: list[float]) -> _boxes.Puma | None:
    """The closed form of a PUMA-like arm, compiled; None: `puma_ik` does it. `base`: the world in the axes of the base;
    `tool`: the last link in those of the tcp; both 4x4. `speeds`: of the joints, rad/s."""
    return None if _boxes is None else _boxes.Puma(astuple(lengths), base, tool, speeds)


def _joints_of(model: pin.Model) -> list[tuple[int, bool, Array, list[float]]]:
    """The joints of a model, as for `Boxes`; none without a compiler, or with a joint that it does not know."""
    if _boxes is None or model.nq != model.njoints - 1:
        return []
    joints = []
    for n in range(1, model.njoints):
        joint, at = model.joints[n], model.jointPlacements[n]
        if joint.idx_q != n - 1 or not joint.shortname().startswith(KINDS):
            return []
        data = joint.createData()
        joint.calc(data, np.zeros(model.nq))
        linear, angular = np.split(np.asarray(data.S).ravel(), 2)
        slides = bool(linear.any())
        joints.append(
            (model.parents[n] - 1, slides, linear if slides else angular, [*at.rotation.flat, *at.translation])
        )
    return joints

"""Boxes around the pieces of a cell, which prove that pairs of pieces are apart (decision 0069).

The proof is compiled (`_boxes.cpp`): a direction that separates two boxes by more than the margin. It is prepared here
from pinocchio's model and coal's solids, so there is no second robot model. What it leaves undecided coal decides.
Without a compiler, or for a joint that it does not know, there are no boxes, and coal decides everything.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtc.model.robot.bodies import Bodies
from rtc.spatial.geometry import Array

try:
    from rtc.model.robot import _boxes
except ImportError:  # it was installed without a compiler
    _boxes = None  # type: ignore[assignment]

KINDS = ("JointModelRX", "JointModelRY", "JointModelRZ", "JointModelRevoluteU", "JointModelP")  # one value each
STEP_M = 0.03  # greatest displacement of a piece between two configurations of which its space is made
HALVINGS = 4  # of a line between two configurations of a path; what is undecided then is measured


class Boxes:
    """The boxes of a cell's pieces and the pairs in force. Not thread-safe."""

    def __init__(self, bodies: Bodies, joints: Sequence[tuple[int, bool, Array, list[float]]]) -> None:
        """`joints`: parent (-1: the world), whether it slides, axis, placement (rotation row by row, position)."""
        self._items = bodies.geometry.geometryObjects
        solids = [item.geometry for item in self._items]
        for solid in solids:
            solid.computeLocalAABB()
        self._centres = [np.asarray(solid.aabb_center) for solid in solids]
        halves = [solid.aabb_local.max_ - centre for solid, centre in zip(solids, self._centres, strict=True)]
        parents, slides, axes, placements = zip(*joints, strict=True)
        pairs = np.array(bodies.pairs, dtype=np.int32).reshape(-1, 2)
        self._proof = _boxes.Boxes(parents, slides, axes, placements, np.array(halves).reshape(-1, 3), pairs)
        for n in range(len(solids)):
            self.place(n)

    def place(self, piece: int) -> None:
        """Take over the parent joint and the placement of a piece from pinocchio's geometry."""
        item = self._items[piece]
        centre = item.placement.act(self._centres[piece])
        self._proof.place(piece, item.parentJoint - 1, [*item.placement.rotation.flat, *centre])

    def use(self, pairs: Array, margins: Array) -> None:
        """The pairs to check, by number in `Bodies.pairs`, and their margins (m)."""
        self._proof.use(pairs, margins)

    def undecided(self, q: Array) -> list[int]:
        """The pairs that are not certainly farther apart than their margins at this configuration."""
        return self._proof.undecided(q)

    def way(self, q: Array, slots: list[int], rows: Array, levers: Array) -> tuple[int, list[int]]:
        """The first part of a way that is not proven free: the number of the row before it, and its undecided pairs.

        Without such a part: the number of the last row, and no pair. `rows`: values of the configuration at `slots`,
        [n][slots], n > 1; the others are those of `q`. `levers`: of each pair in use, [pairs][slots]. A line between
        two rows is halved `HALVINGS` times before it counts as undecided.
        """
        return self._proof.way(q, slots, rows, levers, HALVINGS)

    def space(self, q: Array, slots: list[int], rows: Array, pieces: list[int], levers: Array) -> Array:
        """Boxes in the axes of the world around these pieces on a way, [pieces][6]: low corner, high corner (m).

        `q`, `slots` and `rows` as for `way`; `levers`: of each piece, [pieces][slots]."""
        found: Array = self._proof.space(q, slots, rows, pieces, levers, STEP_M)
        return found


def boxes_of(bodies: Bodies) -> Boxes | None:
    """Boxes in the initial state of a cell; None where coal decides everything."""
    model = bodies.model
    if _boxes is None or model.nq != model.njoints - 1:
        return None
    joints = []
    for n in range(1, model.njoints):
        joint, at = model.joints[n], model.jointPlacements[n]
        if joint.idx_q != n - 1 or not joint.shortname().startswith(KINDS):
            return None
        data = joint.createData()
        joint.calc(data, np.zeros(model.nq))
        linear, angular = np.split(np.asarray(data.S).ravel(), 2)
        slides = bool(linear.any())
        joints.append(
            (model.parents[n] - 1, slides, linear if slides else angular, [*at.rotation.flat, *at.translation])
        )
    return Boxes(bodies, joints) if joints else None

"""Boxes in the axes of the world around the pieces of an arm, for many intervals of its joint values at once. Pure.

They are larger than the pieces, and computed for all intervals together as arrays. So they sort out what is far apart
before exact checks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from rtc.spatial.geometry import Array


class Boxes(NamedTuple):
    """Corners of boxes around the pieces of an arm (m, world): [pieces][3], or [intervals][pieces][3]."""

    low: Array
    high: Array

    def between(self, first: int, last: int) -> Boxes:
        """A box around each piece at all intervals from `first` up to, not including, `last`."""
        return Boxes(self.low[first:last].min(axis=0), self.high[first:last].max(axis=0))

    def apart(self, others: Boxes, clearance_m: float) -> bool:
        """Whether each of these keeps the clearance from each of the others, both [pieces][3]."""
        away = (self.low[:, None] - others.high) > clearance_m
        away |= (others.low - self.high[:, None]) > clearance_m
        return bool(away.any(axis=2).all())


class Chain:
    """The joints of one arm in the model of the whole cell. `q`: a configuration with the values of all other joints.

    Raises ValueError for other joints than revolute and prismatic ones.
    """

    def __init__(self, model: pin.Model, joints: Sequence[int], q: Array) -> None:
        """`joints`: indices of the arm's joints in the configuration, in their order."""
        data = model.createData()
        pin.forwardKinematics(model, data, q)
        ids = [next(n for n in range(1, model.njoints) if model.joints[n].idx_q == at) for at in joints]
        #: joint of the model -> the joint of the chain that moves it (0: none of them), and its place in that one
        self._carried: dict[int, tuple[int, pin.SE3]] = {0: (0, pin.SE3.Identity())}
        terms = np.zeros((3, len(ids), 4, 4))
        for n in range(1, model.njoints):
            before, place = self._carried[model.parents[n]]
            if n not in ids:
                here = data.oMi[model.parents[n]].actInv(data.oMi[n])
                self._carried[n] = (before, place * here)
                continue
            at = ids.index(n)
            if before != at:
                raise ValueError("the joints of an arm must be in one chain")
            terms[:, at] = _terms(model, data, n, place * model.jointPlacements[n])
            self._carried[n] = (at + 1, pin.SE3.Identity())
        self._terms = terms
        self._slides = np.array([_slides(model, data, n) for n in ids])

    def carried(self, joint: int, placement: pin.SE3) -> tuple[int, pin.SE3]:
        """For a joint of the model: the number of the chain's joint that moves it (0: none), and its pose in the axes
        of that joint."""
        number, place = self._carried[joint]
        return number, place * placement

    def places(self, postures: Array) -> Array:
        """Transforms of all joints, the first one that of the world, [joints + 1][postures][4][4]."""
        fixed, first, second = self._terms
        u = np.where(self._slides, postures, np.sin(postures)).T[:, :, None, None]
        v = np.where(self._slides, 0.0, 1.0 - np.cos(postures)).T[:, :, None, None]
        found = np.empty((len(fixed) + 1, len(postures), 4, 4))
        found[0] = np.eye(4)
        found[1:] = fixed[:, None] + u * first[:, None] + v * second[:, None]
        for n in range(2, len(found)):
            found[n] = found[n - 1] @ found[n]
        return found


def _slides(model: pin.Model, data: pin.Data, joint: int) -> bool:
    return bool(np.linalg.norm(_axis(model, data, joint)[:3]) > 0.5)


def _axis(model: pin.Model, data: pin.Data, joint: int) -> Array:
    """The motion of this joint in its own axes, linear above angular."""
    if model.joints[joint].nv != 1 or model.joints[joint].nq != 1:
        raise ValueError(f"{model.names[joint]} is neither revolute nor prismatic")
    jacobian = pin.computeJointJacobian(model, data, pin.neutral(model), joint)
    axis: Array = jacobian[:, model.joints[joint].idx_v]
    return axis


def _terms(model: pin.Model, data: pin.Data, joint: int, place: pin.SE3) -> Array:
    """Matrices (M0, M1, M2) of T(q) = M0 + sin q M1 + (1 - cos q) M2, or of M0 + q M1 for a joint that slides."""
    axis, at = _axis(model, data, joint), place.homogeneous
    terms = np.zeros((3, 4, 4))
    terms[0] = at
    if np.linalg.norm(axis[:3]) > 0.5:
        terms[1, :3, 3] = at[:3, :3] @ axis[:3]
    else:
        cross = pin.skew(axis[3:])
        terms[1, :3, :3] = at[:3, :3] @ cross
        terms[2, :3, :3] = at[:3, :3] @ cross @ cross
    return terms


class Swept:
    """The pieces that one arm moves, with their boxes. `solids`: each with its joint and its place there."""

    def __init__(self, chain: Chain, solids: Sequence[pin.GeometryObject], levers: Array) -> None:
        """`levers`: [pieces][joints of the chain], as in `rtc.model.robot.levers`."""
        self._chain, self._levers = chain, levers
        carried = [chain.carried(solid.parentJoint, solid.placement) for solid in solids]
        self._joints = np.array([joint for joint, _ in carried], dtype=int)
        self._halves = np.array([_half_box(s, at) for s, (_, at) in zip(solids, carried, strict=True)])[:, None]

    def boxes(self, middles: Array, turns: Array) -> Boxes:
        """Boxes that hold each piece at all joint values that differ from the middles by at most the turns.

        Both are [intervals][joints]."""
        placed = self._chain.places(middles)[self._joints] @ self._halves
        centre = placed[..., :3, 3]
        half = np.abs(placed[..., :3, :3]).sum(axis=-1) + (self._levers @ turns.T)[..., None]
        return Boxes((centre - half).transpose(1, 0, 2), (centre + half).transpose(1, 0, 2))


def _half_box(solid: pin.GeometryObject, at: pin.SE3) -> Array:
    """Centre (last column) and half edges (other columns) of a box around a solid that is placed at `at`, [4][4]."""
    solid.geometry.computeLocalAABB()
    box = solid.geometry.aabb_local
    low, high = np.array(box.min_), np.array(box.max_)
    found: Array = at.homogeneous.copy()
    found[:3, 3] = at.act(0.5 * (low + high))
    found[:3, :3] *= 0.5 * (high - low)
    return found

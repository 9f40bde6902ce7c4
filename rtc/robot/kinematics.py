"""Kinematics of one arm from its URDF and base pose: forward, Jacobian, inverse, and causes of IK failure.

Joint vectors are float64 arrays (rad) in the order of the cell's `joints`. Poses are seven floats of the tcp in the
world frame. IK returns all branches: in closed form for a PUMA-like arm, by seeded numeric search for any other.
Collisions are checked in `rtc.robot.collision`, not here.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from rtc.cells import cell as cells
from rtc.protocol.outcomes import ProgramError, Refusal, RefusalReason
from rtc.robot import geometry, numeric_ik, puma_ik
from rtc.robot.geometry import Array, Floats

_TURN = 2 * math.pi
PROJECTIONS = 12  # maximum number of steps of `turned_to`
PROJECTED_RAD = 1e-3  # its greatest error
DAMPING = 1e-6  # of its steps near singularities
MOVES, MOVE_DAMPING = 4, 1e-3  # number of steps of `moved_by`, and their damping


@dataclass(frozen=True)
class JointLimits:
    """Arrays in joint order: rad, rad/s, rad/s^2, N.m."""

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    effort: Array


class ArmModel:
    """Kinematics of one arm of a cell. Not thread-safe: pinocchio's data object is reused.

    Raises ProgramError when the URDF lacks joints or the tcp link.
    """

    def __init__(
        self,
        urdf_text: str,
        base_pose: Floats = geometry.IDENTITY,
        *,
        name: str = "ARM",
        joints: Sequence[str] | None = None,
        tcp_link: str = "tcp",
        acceleration_rad_s2: Floats | None = None,
    ) -> None:
        full = pin.buildModelFromXML(urdf_text)
        names = list(joints) if joints is not None else _revolute(full)
        unknown = [n for n in names if not full.existJointName(n)]
        if unknown or not full.existFrame(tcp_link):
            raise ProgramError(f"{name}: the URDF lacks {', '.join(unknown) or tcp_link}")
        others = [i for i in range(1, full.njoints) if full.names[i] not in names]
        model = pin.buildReducedModel(full, others, pin.neutral(full))  # other joints do not move the tcp
        if list(model.names)[1:] != names:
            raise ProgramError(f"{name}: joints {names} are not in the URDF's order {list(model.names)[1:]}")
        model.gravity.linear[:] = 0  # pinocchio presets the gravity of the earth
        self.name = name
        self.joints = names
        self.model = model
        self.base_pose = geometry.normalise(base_pose)
        self._data = model.createData()
        self._laden: tuple[tuple[float, ...], pin.Model] | None = None  # the last load and its dynamics
        self.tcp_frame = self._tcp = model.getFrameId(tcp_link)  # of `model` and of every `laden` one
        self._base = pin.SE3(geometry.to_matrix(self.base_pose))
        self._to_world = np.kron(np.eye(2), self._base.rotation)  # for a Jacobian
        self.limits = JointLimits(
            lower=model.lowerPositionLimit.copy(),
            upper=model.upperPositionLimit.copy(),
            velocity=model.velocityLimit.copy(),
            acceleration=np.asarray(acceleration_rad_s2 or [5.0] * model.nq, dtype=float),
            effort=model.effortLimit.copy(),
        )
        self._lower, self._upper = self.limits.lower.tolist(), self.limits.upper.tolist()
        self._speeds = self.limits.velocity.tolist()
        self._base_inverse = np.linalg.inv(geometry.to_matrix(self.base_pose))
        tip = model.frames[self._tcp]
        self._tool_inverse = np.linalg.inv(tip.placement.homogeneous)
        self._puma = puma_ik.recognise([model.jointPlacements[i].homogeneous for i in range(1, model.njoints)])
        if tip.parentJoint != model.njoints - 1:
            raise ProgramError(f"{name}: {tcp_link} must be fixed to the last joint")

    @classmethod
    def of(cls, cell: cells.Cell, arm: str) -> ArmModel:
        """The model of an arm of a cell."""
        spec = cell.arm(arm)
        return cls(
            cell.urdf(arm),
            spec.base.pose,
            name=spec.name,
            joints=spec.joints,
            tcp_link=spec.tcp_link,
            acceleration_rad_s2=spec.acceleration_rad_s2,
        )

    def laden(self, mass_kg: float, com_m: Floats, inertia_kg_m2: Floats) -> pin.Model:
        """The dynamics with a body in the hand.

        `com_m`: centre of mass in tcp axes; `inertia_kg_m2`: about the centre of mass, xx yy zz xy xz yz.
        """
        load = (mass_kg, *com_m, *inertia_kg_m2)
        if self._laden is not None and self._laden[0] == load:
            return self._laden[1]
        xx, yy, zz, xy, xz, yz = inertia_kg_m2
        about_com = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        model, tip = self.model.copy(), self.model.frames[self._tcp]
        body = pin.Inertia(mass_kg, np.asarray(com_m, dtype=float), about_com)
        model.appendBodyToJoint(tip.parentJoint, body, tip.placement)
        self._laden = (load, model)
        return model

    def torques(self, joints: Array, velocities: Array, accelerations: Array, laden: pin.Model | None = None) -> Array:
        """Joint torques (N.m) of each row of joint values (rad, rad/s, rad/s^2), by inverse dynamics.

        `laden`: the dynamics with a load; without it those of the empty hand.
        """
        model, data = (self.model, self._data) if laden is None else (laden, laden.createData())
        rows = zip(joints, velocities, accelerations, strict=True)
        return np.array([pin.rnea(model, data, q, v, a) for q, v, a in rows])

    # --- forward -----------------------------------------------------------------------------------------

    def fk(self, joints: Floats) -> Array:
        """Pose of the tcp, world frame."""
        return _pose_of(self._base * self._placement(joints))

    def jacobian(self, joints: Floats) -> Array:
        """6 x n: tcp velocity [linear m/s, angular rad/s] in world axes per joint velocity (rad/s)."""
        q = np.asarray(joints, dtype=float)
        local = pin.computeFrameJacobian(self.model, self._data, q, self._tcp, pin.LOCAL_WORLD_ALIGNED)
        turned: Array = self._to_world @ local
        return turned

    def tcp_speeds(self, joints: Array, velocities: Array) -> Array:
        """Speed of the tcp (m/s) at each row of joint values (rad) and joint velocities (rad/s)."""
        model, data, tcp = self.model, self._data, self._tcp
        linear = np.array([pin.computeFrameJacobian(model, data, q, tcp, pin.LOCAL)[:3] for q in joints])
        speeds: Array = np.sqrt((np.einsum("nij,nj->ni", linear, velocities) ** 2).sum(axis=1))
        return speeds

    def effective_mass_kg(self, joints: Floats, direction: Floats) -> float:
        """Effective mass of the unloaded tcp along a direction (unit vector, world axes): 1 / (d J M^-1 J' d)."""
        q = np.asarray(joints, dtype=float)
        upper = np.triu(pin.crba(self.model, self._data, q))
        mass = upper + np.triu(upper, 1).T
        along = np.asarray(direction, dtype=float) @ self.jacobian(q)[:3]
        return 1.0 / max(float(along @ np.linalg.solve(mass, along)), 1e-6)

    def sigma_min(self, joints: Floats) -> float:
        """Least singular value of the Jacobian, 0 in a singularity. It mixes m and rad: use it for comparison only."""
        return float(np.linalg.svd(self.jacobian(joints), compute_uv=False)[-1])

    def limit_margin_rad(self, joints: Floats) -> float:
        """Least distance (rad) of any joint from its limits, for one posture or many; negative beyond a limit."""
        q = np.asarray(joints, dtype=float)
        return float(min((q - self.limits.lower).min(), (self.limits.upper - q).min()))

    # --- inverse -----------------------------------------------------------------------------------------

    def ik(self, target: Floats, near: Floats | None = None, margin_rad: float = 0.0) -> list[Array]:
        """All joint vectors that bring the tcp to `target`, each at least `margin_rad` from every limit.

        Sorted by the motion time from `near`, or from mid-range without it. If empty, `why_no_ik` returns the cause.
        """
        reference = np.asarray(near, dtype=float) if near is not None else self.middle
        within = [q for raw in self._branches(target, reference) for q in self._turns_within(raw, margin_rad)]
        if len(within) < 2:
            return within
        travels_s = (np.abs(np.array(within) - reference) / self.limits.velocity).max(axis=1)
        return [within[n] for n in np.argsort(travels_s, kind="stable").tolist()]

    def travel_time_s(self, a: Floats, b: Floats) -> float:
        """Motion time (s) of the slowest joint from `a` to `b` at full speed; `ik` sorts by it."""
        return float((np.abs(np.asarray(b) - np.asarray(a)) / self.limits.velocity).max())

    @property
    def middle(self) -> Array:
        return 0.5 * (self.limits.lower + self.limits.upper)

    def follow(self, target: Floats, near: Floats) -> Array | None:
        """The branch nearest to `near`, each joint shifted by whole turns to be nearest, *regardless of limits*.

        None: out of reach. For small steps along a line, where another branch would cause a jump.
        """
        found = self.follow_all([target], near)
        return found[0] if len(found) else None

    def follow_all(self, targets: Sequence[Floats] | Array, near: Floats) -> Array:
        """As `follow` for one target after the other, each near the one before, [targets][joints].

        Ends before the first target that is out of reach.
        """
        now = np.asarray(near, dtype=float).tolist()
        found: list[list[float]] = []
        flanges = self._base_inverse @ geometry.to_matrices(targets) @ self._tool_inverse
        for target, flange in zip(targets, flanges[:, :3].tolist(), strict=True):
            branch = self._nearest_branch(target, flange, now)
            if branch is None:
                break
            found.append(branch)
            now = branch
        return np.array(found, dtype=float).reshape(-1, len(self.joints))

    def turned_to(self, attitude: Floats, joints: Floats) -> Array | None:
        """Joint values (rad) near `joints` at which the tcp has the attitude of this pose (world), wherever it is.

        Regardless of limits. None: not found in `PROJECTIONS` steps.
        """
        turn = self._base.rotation.T @ geometry.to_matrix(attitude)[:3, :3]
        q = np.array(joints, dtype=float)
        for _ in range(PROJECTIONS):
            error = pin.log3(self._tip_rotation(q).T @ turn)
            if error @ error < PROJECTED_RAD * PROJECTED_RAD:
                return q
            jacobian = pin.computeFrameJacobian(self.model, self._data, q, self._tcp, pin.LOCAL)[3:]
            q = q + jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + DAMPING * np.eye(3), error)
        return None

    def moved_by(self, by_m: Floats, joints: Floats) -> Array:
        """Joint values (rad) near `joints` with the tcp moved by about `by_m` (world axes) and its attitude kept.

        Regardless of limits. Near a singularity or the end of the reach the tcp moves less.
        """
        q = np.array(joints, dtype=float)
        goal = self._placement(q).copy()
        goal.translation = goal.translation + self._base.rotation.T @ np.asarray(by_m, dtype=float)
        for _ in range(MOVES):
            error = pin.log6(self._placement(q).actInv(goal)).vector
            jacobian = pin.computeFrameJacobian(self.model, self._data, q, self._tcp, pin.LOCAL)
            q = q + jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + MOVE_DAMPING * np.eye(6), error)
        return q

    def why_no_ik(self, target: Floats, margin_rad: float = 0.0) -> Refusal | None:
        """The cause of an IK failure: the missing reach, or the exceeded joint limit. None: IK succeeds."""
        raws = self._branches(target, self.middle)
        if not raws:
            return self._out_of_reach(target)
        if any(self._turns_within(raw, margin_rad) for raw in raws):
            return None
        least = min((self._worst_joint(raw, margin_rad) for raw in raws), key=lambda worst: worst[0])
        return self._limit_passed(*least[1:], margin_rad)

    def why_not_within(self, joints: Floats, margin_rad: float = 0.0) -> Refusal | None:
        """The joint of this posture that exceeds its limits most; None: all joints are within them."""
        q = np.asarray(joints, dtype=float)
        below, above = self.limits.lower + margin_rad - q, q - self.limits.upper + margin_rad
        if max(below.max(), above.max()) <= 0:
            return None
        n = int(np.maximum(below, above).argmax())
        limit = self._lower[n] if below[n] > above[n] else self._upper[n]
        return self._limit_passed(n, float(q[n]), limit, margin_rad)

    # --- inside --------------------------------------------------------------------------------------------

    def _tip_rotation(self, joints: Array) -> Array:
        """Rotation of the tcp in the axes of the base."""
        pin.framesForwardKinematics(self.model, self._data, joints)
        rotation: Array = self._data.oMf[self._tcp].rotation
        return rotation

    def _placement(self, joints: Floats) -> pin.SE3:
        pin.framesForwardKinematics(self.model, self._data, np.asarray(joints, dtype=float))
        return self._data.oMf[self._tcp]

    def _branches(self, target: Floats, reference: Array) -> list[list[float]]:
        last_link = self._base_inverse @ geometry.to_matrix(target) @ self._tool_inverse
        if self._puma is not None:
            return puma_ik.branches(self._puma, last_link, float(reference[3]))
        goal = pin.SE3(self._base_inverse @ geometry.to_matrix(target))
        return numeric_ik.branches(self.model, self._data, self._tcp, goal, reference)

    def _nearest_branch(self, target: Floats, flange: puma_ik.Rows, near: list[float]) -> list[float] | None:
        """The branch of a tcp pose nearest to `near` (rad); `flange`: the same pose as frame 6 in frame 0."""
        if self._puma is not None:
            return puma_ik.nearest(self._puma, flange, near, self._speeds)
        raws = self._branches(target, np.array(near))
        if not raws:
            return None
        table = np.array(raws)
        table -= _TURN * np.round((table - near) / _TURN)
        best: list[float] = table[int((np.abs(table - near) / self.limits.velocity).max(axis=1).argmin())].tolist()
        return best

    def _turns_within(self, raw: list[float], margin: float) -> list[Array]:
        """The same posture with each angle shifted by -1, 0 or 1 turn, as far as the limits allow."""
        choices = []
        for angle, lower, upper in zip(raw, self._lower, self._upper, strict=True):
            fits = [a for a in (angle, angle - _TURN, angle + _TURN) if lower + margin <= a <= upper - margin]
            if not fits:
                return []
            choices.append(fits)
        return [np.array(q) for q in itertools.product(*choices)]

    def _worst_joint(self, raw: list[float], margin: float) -> tuple[float, int, float, float]:
        """(excess, joint, value, limit) of the joint that exceeds its limits most, each angle at its best turn."""
        worst = (-math.inf, 0, 0.0, 0.0)
        for n, (angle, lower, upper) in enumerate(zip(raw, self._lower, self._upper, strict=True)):
            best = min(
                max((lower + margin - a, n, a, lower), (a - upper + margin, n, a, upper))
                for a in (angle, angle - _TURN, angle + _TURN)
            )
            worst = max(worst, best)
        return worst

    def _limit_passed(self, joint: int, value: float, limit: float, margin: float) -> Refusal:
        side = "upper" if limit == self._upper[joint] else "lower"
        lowest, highest = (math.degrees(n) for n in (self._lower[joint] + margin, self._upper[joint] - margin))
        kept = f", with a margin of {math.degrees(margin):.1f} deg" if margin else ""
        return Refusal(
            reason=RefusalReason.INFEASIBLE,
            message=(
                f"{self.name} would have to turn {self.joints[joint]} to {math.degrees(value):.1f} deg; "
                f"its {side} limit is {math.degrees(limit):.1f} deg{kept}"
            ),
            clears=f"{self.joints[joint]} between {lowest:.1f} and {highest:.1f} deg: "
            "other joint values, or another attitude, arm or grasp point",
            detail={
                "cause": "joint_limit",
                "arm": self.name,
                "joint": self.joints[joint],
                "value_rad": value,
                "limit_rad": limit,
                "margin_rad": margin,
                "excess_rad": (value - limit if side == "upper" else limit - value) + margin,
            },
        )

    def _out_of_reach(self, target: Floats) -> Refusal:
        words, missing = "out of reach", 0.0
        if self._puma is not None:
            last_link = self._base_inverse @ geometry.to_matrix(target) @ self._tool_inverse
            words, missing = puma_ik.shortfall(self._puma, last_link[:3, 3])
        by = f" by {missing * 1000:.0f} mm" if missing else ""
        return Refusal(
            reason=RefusalReason.INFEASIBLE,
            message=f"{self.name} cannot reach: the wrist would have to be {words}{by}",
            clears="another arm, or a nearer place",
            detail={"cause": "reach", "arm": self.name, "which": words, "distance_m": missing},
        )


def _revolute(model: pin.Model) -> list[str]:
    """The default joints of an arm: all revolute ones."""
    return [model.names[i] for i in range(1, model.njoints) if model.joints[i].shortname().startswith("JointModelR")]


def _pose_of(placement: pin.SE3) -> Array:
    pose: Array = pin.SE3ToXYZQUAT(placement)
    return geometry.normalise(pose)

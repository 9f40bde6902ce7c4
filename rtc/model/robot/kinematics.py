"""Kinematics of one arm from its URDF and base pose: forward, Jacobian, inverse, and causes of IK failure.

Joint vectors are float64 arrays in the order of the cell's `joints`: rad, and m for a joint that slides. Poses are
seven floats of the tcp in the world frame. IK returns all branches in closed form for a PUMA-like arm, and by seeded
numeric search for any other.
Collisions are checked in `rtc.model.robot.collision`, not here.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin

from rtc.model.cells import cell as cells
from rtc.model.robot import boxes, numeric_ik, puma_ik
from rtc.protocol import causes
from rtc.protocol.advice import ANOTHER_ARM, by_person
from rtc.protocol.outcomes import ProgramError, Refusal, RefusalReason
from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats

PROJECTIONS = 12  # maximum number of steps of `turned_to`
PROJECTED_RAD = 1e-3  # its greatest error
DAMPING = 1e-6  # of its steps near singularities
MOVES, MOVE_DAMPING = 4, 1e-3  # number of steps of `moved_by`, and their damping
SAME_BRANCH_RAD = 1.5  # a larger change of a joint in `moved_by` is another branch
WHOLE_M, MIN_WEIGHT = 0.6, 1.0 / 3.0  # a joint that moves the hand by this much per rad, or more, has the weight 1
SLIDE_MARGIN = 0.1  # m per rad: the margin of a joint that slides, 5 mm for 3 deg
KEPT_MARGINS = 64  # maximum number of margins whose bounds are kept
NEAR_M, NEAR_RAD = 0.0005, 0.005  # smaller distances are not stated


@dataclass(frozen=True)
class JointLimits:
    """Arrays in joint order: rad, rad/s, rad/s^2, N.m; m, m/s, m/s^2, N for a joint that slides."""

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
        gravity_m_s2: Floats = (0.0, 0.0, 0.0),
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
        # pinocchio presets the gravity of the earth. The gravity of the cell is in world axes, that of the model in
        # base axes.
        model.gravity.linear[:] = geometry.rotate(geometry.inverse(geometry.normalise(base_pose)), gravity_m_s2)
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
        # Code of packages is given this model, and every later sentence uses it.
        for values in (self.base_pose, *vars(self.limits).values()):
            values.setflags(write=False)
        self._lower, self._upper = self.limits.lower.tolist(), self.limits.upper.tolist()
        self._by_margin: dict[float, tuple[Array, Array]] = {}  # see `bounds`
        self._speeds = self.limits.velocity.tolist()
        self._base_inverse: Array = np.asarray(np.linalg.inv(geometry.to_matrix(self.base_pose)), dtype=float)
        tip = model.frames[self._tcp]
        self._tool_inverse = np.linalg.inv(tip.placement.homogeneous)
        self.weightless = not np.any(model.gravity.linear)
        if tip.parentJoint != model.njoints - 1:
            raise ProgramError(f"{name}: {tcp_link} must be fixed to the last joint")
        try:
            self._chain = numeric_ik.Chain(model, self._tcp)
        except ValueError as error:
            raise ProgramError(f"{name}: {error}") from error
        self.slides: list[bool] = self._chain.slides.tolist()  # by joint: it slides (m), or it turns (rad)
        self._per_rad = np.where(self._chain.slides, SLIDE_MARGIN, 1.0)
        turning_about_z = all(model.joints[i].shortname() == "JointModelRZ" for i in range(1, model.njoints))
        placements = [model.jointPlacements[i].homogeneous for i in range(1, model.njoints)]
        self._in_base = lru_cache(maxsize=4)(self._turn_in_base)  # a search asks for one attitude thousands of times
        self._compiled = boxes.arm_of(model, tip)
        self._closed_form = puma_ik.recognise(placements) if turning_about_z else None
        self._puma = None  # the closed form, compiled
        if self._closed_form is not None:
            self._puma = boxes.puma_of(self._closed_form, self._base_inverse, self._tool_inverse, self._speeds)
        sweeps = _sweeps(placements, tip.placement.translation, self._chain.slides)
        #: by joint: the weight of its displacement along a path, because some joints move the hand less
        self.step_weights = np.where(self._chain.slides, 1.0, np.clip(sweeps / WHOLE_M, MIN_WEIGHT, 1.0))

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
            gravity_m_s2=cell.gravity_m_s2,
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
        jacobians = np.array([pin.computeFrameJacobian(model, data, q, tcp, pin.LOCAL) for q in joints])
        linear = (jacobians[:, :3] @ velocities[:, :, None])[:, :, 0]
        speeds: Array = np.sqrt((linear * linear).sum(axis=1))
        return speeds

    def effective_mass_kg(self, joints: Floats, direction: Floats) -> float:
        """Effective mass of the unloaded tcp along a direction (unit vector, world axes): 1 / (d J M^-1 J' d)."""
        q = np.asarray(joints, dtype=float)
        mass = self.mass_matrix(q)
        along = np.asarray(direction, dtype=float) @ self.jacobian(q)[:3]
        return 1.0 / max(float(along @ np.linalg.solve(mass, along)), 1e-6)

    def mass_matrix(self, joints: Floats) -> Array:
        """Joint-space inertia of the unloaded arm (kg m^2; kg for a joint that slides)."""
        upper = np.triu(pin.crba(self.model, self._data, np.asarray(joints, dtype=float)))
        full: Array = upper + np.triu(upper, 1).T
        return full

    def sigma_min(self, joints: Floats) -> float:
        """Least singular value of the Jacobian, 0 in a singularity. It mixes m and rad: use it for comparison only."""
        return float(np.linalg.svd(self.jacobian(joints), compute_uv=False)[-1])

    def margins(self, margin_rad: float) -> Array:
        """By joint: the distance from its limits (rad, m) that this margin means."""
        kept: Array = margin_rad * self._per_rad
        return kept

    def limit_margin_rad(self, joints: Floats) -> float:
        """Least margin (rad) that any joint keeps from its limits, for one posture or many; negative beyond a limit."""
        q = np.asarray(joints, dtype=float)
        least = np.minimum(q - self.limits.lower, self.limits.upper - q) / self._per_rad
        return float(least.min())

    # --- inverse -----------------------------------------------------------------------------------------

    def ik(self, target: Floats, near: Floats | None = None, margin_rad: float = 0.0) -> list[Array]:
        """Joint vectors that bring the tcp to `target`, each at least `margin_rad` from every limit.

        Sorted by the motion time from `near`, or from mid-range without it. If empty, `why_no_ik` returns the cause.
        Without a closed form some branches may be missing, and the order prefers distance from limits and
        singularities. For an arm with more than six joints they are samples of an infinite number.
        """
        reference = np.asarray(near, dtype=float) if near is not None else self.middle
        if self._closed_form is None:
            found = self._chain.solutions(self._goal(target), reference, self.margins(margin_rad))
            if not found:
                return [q for raw in self._branches(target, reference) for q in self._turns_within(raw, margin_rad)]
            return [q for raw in found for q in self._nearest_turns(raw, reference, margin_rad)]
        if self._puma is not None:
            return [*self._puma.within(target, reference, *self.bounds(margin_rad))]
        within = [q for raw in self._branches(target, reference) for q in self._turns_within(raw, margin_rad)]
        if len(within) < 2:
            return within
        order = np.argsort(self.travel_times_s(within, reference), kind="stable")
        return [within[n] for n in order.tolist()]

    def travel_times_s(self, postures: Sequence[Floats], reference: Floats) -> Array:
        """Motion time (s) of the slowest joint from `reference` to each posture, at full speed; `ik` sorts by it."""
        times_s: Array = (np.abs(np.asarray(postures) - reference) / self.limits.velocity).max(axis=1)
        return times_s

    @property
    def middle(self) -> Array:
        return 0.5 * (self.limits.lower + self.limits.upper)

    def nearest_ik(self, target: Floats, near: Floats) -> Array | None:
        """The branch nearest to `near`, each joint shifted by whole turns to be nearest, *regardless of limits*.

        None: out of reach. For small steps along a line, where another branch would cause a jump.
        """
        found = self.ik_along([target], near)
        return found[0] if len(found) else None

    def ik_along(self, targets: Sequence[Floats] | Array, near: Floats) -> Array:
        """As `nearest_ik` for one target after the other, each near the one before, [targets][joints].

        Ends before the first target that is out of reach.
        """
        if self._closed_form is None:
            return self._followed(targets, np.asarray(near, dtype=float))
        if self._puma is not None:
            return np.asarray(self._puma.along(targets, near))
        now = np.asarray(near, dtype=float).tolist()
        found: list[list[float]] = []
        flanges = self._base_inverse @ geometry.to_matrices(targets) @ self._tool_inverse
        for flange in flanges[:, :3].tolist():
            branch = puma_ik.nearest(self._closed_form, flange, now, self._speeds)
            if branch is None:
                break
            found.append(branch)
            now = branch
        return np.array(found, dtype=float).reshape(-1, len(self.joints))

    def ik_line(self, begin: Array, end: Floats, fractions: Array, near: Floats) -> Array:
        """As `ik_along`, at these fractions (0..1) of the straight line from one pose to another."""
        if self._puma is not None:
            return np.asarray(self._puma.line(begin, end, fractions, near))
        return self.ik_along(geometry.interpolate_all(begin, end, fractions), near)

    def projection(self, attitude: Floats | None) -> boxes.Projection:
        """What `turned_to` does, for compiled code: to this attitude, or to none."""
        turn = np.empty(0) if attitude is None else self._in_base(tuple(attitude[3:])).ravel()
        return boxes.Projection(self._compiled, turn, PROJECTIONS, PROJECTED_RAD, DAMPING)

    def turned_to(self, attitude: Floats, joints: Floats) -> Array | None:
        """Joint values (rad) near `joints` at which the tcp has the attitude of this pose (world), wherever it is.

        Regardless of limits. None: not found in `PROJECTIONS` steps.
        """
        turn = self._in_base(tuple(attitude[3:]))
        if self._compiled is not None:
            found = self._compiled.turned_to(joints, turn, PROJECTIONS, PROJECTED_RAD, DAMPING)
            return None if found is None else np.array(found)
        q = np.array(joints, dtype=float)
        for _ in range(PROJECTIONS):
            error = pin.log3(self._tip_rotation(q).T @ turn)
            if error @ error < PROJECTED_RAD * PROJECTED_RAD:
                return q
            jacobian = pin.computeFrameJacobian(self.model, self._data, q, self._tcp, pin.LOCAL)[3:]
            q += np.linalg.solve(jacobian @ jacobian.T + DAMPING * np.eye(3), error) @ jacobian
        return None

    def moved_by(self, by_m: Floats, joints: Floats) -> Array:
        """Joint values (rad) near `joints` with the tcp moved by about `by_m` (world axes) and its attitude kept.

        Regardless of limits. Near a singularity or the end of the reach the tcp moves less.
        """
        q = np.array(joints, dtype=float)
        if self._closed_form is not None:
            found = self.nearest_ik(geometry.translate(self.fk(q), by_m), q)
            if found is not None and np.abs(found - q).max() < SAME_BRANCH_RAD:
                return found
        goal = self._placement(q).copy()
        goal.translation = goal.translation + self._base.rotation.T @ np.asarray(by_m, dtype=float)
        for _ in range(MOVES):
            error = pin.log6(self._placement(q).actInv(goal)).vector
            jacobian = pin.computeFrameJacobian(self.model, self._data, q, self._tcp, pin.LOCAL)
            q = q + jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + MOVE_DAMPING * np.eye(6), error)
        return q

    def why_no_ik(self, target: Floats, margin_rad: float = 0.0) -> Refusal | None:
        """The cause of an IK failure: the missing reach, or the exceeded joint limit. None: IK succeeds."""
        if self._closed_form is None and self._chain.solutions(
            self._goal(target), self.middle, self.margins(margin_rad)
        ):
            return None
        raws = self._branches(target, self.middle)
        if not raws:
            return self._out_of_reach(target)
        if any(self._turns_within(raw, margin_rad) for raw in raws):
            return None
        least = min((self._worst_joint(raw, margin_rad) for raw in raws), key=lambda worst: worst[0])
        return self._limit_passed(*least[1:], margin_rad)

    def why_not_within(self, joints: Floats, margin_rad: float = 0.0) -> Refusal | None:
        """The joint of this posture that exceeds its limits most; None: all joints are within them."""
        q, (lower, upper) = np.asarray(joints, dtype=float), self.bounds(margin_rad)
        below, above = lower - q, q - upper
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

    def _turn_in_base(self, attitude: tuple[float, ...]) -> Array:
        """The rotation of this quaternion of the world in the axes of the base."""
        turn: Array = self._base.rotation.T @ geometry.to_matrix((0.0, 0.0, 0.0, *attitude))[:3, :3]
        return np.ascontiguousarray(turn)

    def _placement(self, joints: Floats) -> pin.SE3:
        pin.framesForwardKinematics(self.model, self._data, np.asarray(joints, dtype=float))
        return self._data.oMf[self._tcp]

    def _goal(self, target: Floats) -> pin.SE3:
        """A tcp pose in the axes of the base."""
        return pin.SE3(self._base_inverse @ geometry.to_matrix(target))

    def _branches(self, target: Floats, reference: Array) -> list[list[float]]:
        """Joint values regardless of limits."""
        if self._closed_form is not None:
            last_link = self._base_inverse @ geometry.to_matrix(target) @ self._tool_inverse
            return puma_ik.branches(self._closed_form, last_link[:3].tolist(), float(reference[3]))
        return [q.tolist() for q in self._chain.without_limits(self._goal(target), reference)]

    def _followed(self, targets: Sequence[Floats] | Array, near: Array) -> Array:
        """As `ik_along`, without a closed form."""
        found: list[Array] = []
        for target in targets:
            q = self._chain.nearest_ik(self._goal(target), near)
            if q is None:
                break
            found.append(q)
            near = q
        return np.array(found, dtype=float).reshape(-1, len(self.joints))

    def _nearest_turns(self, q: Array, reference: Array, margin: float) -> list[Array]:
        """The same posture with whole turns added where the limits allow: as found, and nearest to `reference`."""
        turned = q - math.tau * np.round((q - reference) / math.tau) * ~self._chain.slides
        margins = self.margins(margin)
        outside = (turned < self.limits.lower + margins) | (turned > self.limits.upper - margins)
        turned = np.where(outside, q, turned)
        return [q] if np.array_equal(turned, q) else [turned, q]

    def _turns_within(self, raw: list[float], margin: float) -> list[Array]:
        """The same posture with each angle shifted by -1, 0 or 1 turn, as far as the limits allow."""
        choices = []
        bounds = (side.tolist() for side in self.bounds(margin))
        for angle, slides, least, most in zip(raw, self.slides, *bounds, strict=True):
            same = (angle,) if slides else (angle, angle - math.tau, angle + math.tau)
            fits = [a for a in same if least <= a <= most]
            if not fits:
                return []
            choices.append(fits)
        return [np.array(q) for q in itertools.product(*choices)]

    def bounds(self, margin_rad: float) -> tuple[Array, Array]:
        """The lower and upper limits of all joints, this margin inside."""
        known = self._by_margin.get(margin_rad)
        if known is None:
            if len(self._by_margin) >= KEPT_MARGINS:
                self._by_margin.clear()
            margins = self.margins(margin_rad)
            known = self._by_margin[margin_rad] = self.limits.lower + margins, self.limits.upper - margins
        return known

    def _worst_joint(self, raw: list[float], margin: float) -> tuple[float, int, float, float]:
        """(excess, joint, value, limit) of the joint that exceeds its limits most, each angle at its best turn."""
        worst = (-math.inf, 0, 0.0, 0.0)
        margins = self.margins(margin).tolist()
        for n, (angle, lower, upper, margin) in enumerate(zip(raw, self._lower, self._upper, margins, strict=True)):
            best = min(
                max((lower + margin - a, n, a, lower), (a - upper + margin, n, a, upper))
                for a in ((angle,) if self.slides[n] else (angle, angle - math.tau, angle + math.tau))
            )
            worst = max(worst, best)
        return worst

    def _limit_passed(self, joint: int, value: float, limit: float, margin: float) -> Refusal:
        side = "upper" if limit == self._upper[joint] else "lower"
        slides, margin = self.slides[joint], float(self.margins(margin)[joint])
        lowest, highest = (self.shown(joint, n) for n in (self._lower[joint] + margin, self._upper[joint] - margin))
        kept = f", with a margin of {self.shown(joint, margin)}" if margin else ""
        return Refusal(
            reason=RefusalReason.INFEASIBLE,
            message=(
                f"{self.name} would have to {'move' if slides else 'turn'} {self.joints[joint]} to "
                f"{self.shown(joint, value)}; its {side} limit is {self.shown(joint, limit)}{kept}"
            ),
            clears=[
                *by_person(f"{self.joints[joint]} between {lowest} and {highest}"),
                *by_person("another attitude or grasp point"),
                ANOTHER_ARM,
            ],
            cause=causes.JointLimitPassed(
                arm=self.name,
                joint=self.joints[joint],
                value_rad=value,
                limit_rad=limit,
                margin_rad=margin,
                excess_rad=(value - limit if side == "upper" else limit - value) + margin,
            ),
        )

    def shown(self, joint: int, value: float) -> str:
        """A value of a joint in deg, or in mm if it slides."""
        return f"{1e3 * value:.0f} mm" if self.slides[joint] else f"{math.degrees(value):.1f} deg"

    def _out_of_reach(self, target: Floats) -> Refusal:
        turned_rad: float | None = None
        if self._closed_form is not None:
            last_link = self._base_inverse @ geometry.to_matrix(target) @ self._tool_inverse
            words, missing = puma_ik.shortfall(self._closed_form, last_link[:3, 3])
            message = f"the wrist would have to be {words or 'out of reach'}"
            message += f" by {missing * 1000:.0f} mm" if missing else ""
        else:
            near = self._chain.nearest_approach(self._goal(target), self.middle)
            words, missing = "out of reach", near.metres
            off = [f"{1e3 * near.metres:.0f} mm"] if near.metres >= NEAR_M else []
            off += [f"{math.degrees(near.radians):.0f} deg"] if near.radians >= NEAR_RAD else []
            message = f"the nearest posture found ends {' and '.join(off) or 'just'} short of it"
            if len(self.joints) < numeric_ik.WHOLE:
                message += f"; with {len(self.joints)} joints it reaches each place in some attitudes only"
            turned_rad = near.radians
        return Refusal(
            reason=RefusalReason.INFEASIBLE,
            message=f"{self.name} cannot reach: {message}",
            clears=[*by_person("a nearer place" if missing else "another attitude or place"), ANOTHER_ARM],
            cause=causes.OutOfReach(arm=self.name, which=words, distance_m=missing, turned_rad=turned_rad),
        )


def _sweeps(placements: Sequence[Array], tool: Array, slides: Array) -> Array:
    """By joint: how far the hand moves at most when it turns (m per rad) or slides (1)."""
    lengths = [float(np.linalg.norm(at[:3, 3])) for at in placements[1:]] + [float(np.linalg.norm(tool))]
    beyond = np.cumsum(lengths[::-1])[::-1]
    # A joint that turns about the line to the next one does not move it.
    axial = [abs(float(at[2, 3])) for at in placements[1:]] + [0.0]
    return np.where(slides, 1.0, beyond - axial)


def _revolute(model: pin.Model) -> list[str]:
    """The default joints of an arm: all revolute ones."""
    return [model.names[i] for i in range(1, model.njoints) if model.joints[i].shortname().startswith("JointModelR")]


def _pose_of(placement: pin.SE3) -> Array:
    pose: Array = pin.SE3ToXYZQUAT(placement)
    return geometry.normalise(pose)

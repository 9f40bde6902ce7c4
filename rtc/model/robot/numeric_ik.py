"""Numeric inverse kinematics of any serial arm, by damped Gauss-Newton from many starts at once. Deterministic.

A table of seeded random postures is computed once for each arm. A search begins at a reference and at the postures of
the table whose tcp is nearest to the goal, so a few iterations suffice. All starts run together as arrays. An arm with
more than six joints moves away from its limits in the null space on the way. So its results differ in the redundant
joints too. The number of iterations is bounded: a search without a result ends after some 20 ms.

Values of joints are rad, or m for a joint that slides. Poses are in the axes of the base.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from rtc.spatial.geometry import Array

MIN_JOINTS = 2  # joints of an arm
TABLE = 2048  # postures in the table
SEED = 560
BATCHES = (31, 96)  # number of starts from the table; the second batch runs only if the first has no result
STEPS = (24, 60)  # maximum number of iterations of each batch
ENOUGH = 1e-9  # norm of the residual twist (m and rad) for convergence
# An arm with fewer joints than a pose has axes reaches it only as well as the figures of its URDF are rounded: its
# results are the nearest postures, if they are as near as this, after a step smaller than STILL (rad, m).
WHOLE, NEAR_M, NEAR_RAD, STILL = 6, 0.0003, math.radians(0.3), 1e-6
TURN_M = 0.05  # a rest of one radian counts as much as this one of position: the place matters more
WANTED, WANTED_STEPS = 12, 9  # with this many results a batch ends after this many iterations
HOPELESS_STEPS, HOPELESS = 14, 0.02  # after so many iterations a start that leads to the goal is nearer than this
METRES_PER_RAD = 0.25  # of the distance between poses, to choose starts
MAX_STEP = 0.6  # maximum change of a joint in one iteration (rad, m)
DAMPING, MIN_DAMPING = 0.1, 1e-10  # share of the squared residual, and floor
NULL_STEPS, NULL_GAIN = 6, 0.15  # iterations with motion in the null space, and its gain
SELF_MOTIONS, SELF_STEPS = (-1.2, -0.8, -0.4, 0.4, 0.8, 1.2), 7  # rad, of further starts beside the best result
SAME = 1e-3  # nearer results count as equal
APART = 0.1  # the same for an arm with redundant joints, whose results are not isolated
# Penalty of the ranking, as a factor of the motion time and in seconds.
NEAR_LIMIT = 0.06  # share of a joint's range; a joint that is nearer to its limit is penalised
NEAR_SINGULAR = 0.25  # share of the arm's typical manipulability; a smaller one is penalised
PENALTY, PENALTY_S = 2.0, 0.15  # the second is small, so that a short motion of the hand is one of the arm, too
FOLLOW_STEPS = 12  # maximum number of iterations of `nearest_ik`
FOLLOW_GAIN = 0.05
HELD, MAX_HELD = 0.15, 0.06  # share of its range, and distance (rad, m), of a limit at which a redundant joint stays


class NearestReach(NamedTuple):
    """The nearest approach to a goal that is out of reach."""

    joints: Array
    metres: float
    radians: float


class Chain:
    """A serial chain of joints up to the tcp, for many configurations at once.

    `model`: the reduced model of pinocchio, each joint on the one before. Raises ValueError for other joints than
    revolute and prismatic ones.
    """

    def __init__(self, model: pin.Model, tcp: int) -> None:
        self._model, self._data, self._tcp = model, model.createData(), tcp
        self.lower, self.upper = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
        self.velocity = np.maximum(model.velocityLimit, 1e-6)
        self.count = model.nv
        if model.nq != model.nv:
            raise ValueError("a continuous joint has no limits")
        if self.count < MIN_JOINTS:
            raise ValueError(f"it has {self.count} moving joint; an arm needs {MIN_JOINTS} or more")
        self.slides = np.zeros(self.count, dtype=bool)
        self._weights = None if self.count >= WHOLE else np.array([1.0] * 3 + [TURN_M] * 3)
        self._joints = [self._joint(n) for n in range(1, model.njoints)]
        tip = model.frames[tcp].placement
        self._tip_turn, self._tip_at = tip.rotation.copy(), tip.translation.copy()

    def _joint(self, n: int) -> tuple[Array, Array, Array, Array, Array]:
        """(position, axis, and three matrices: R(q) = M0 + sin q M1 + (1 - cos q) M2) in the joint before."""
        model, at = self._model, self._model.jointPlacements[n]
        motion = pin.computeJointJacobian(model, self._data, pin.neutral(model), n)[:, n - 1]
        slides = bool(np.linalg.norm(motion[:3]) > 0.5)
        self.slides[n - 1] = slides
        axis = motion[:3] if slides else motion[3:]
        cross = pin.skew(axis)
        turn = at.rotation
        return at.translation.copy(), turn @ axis, turn.copy(), turn @ cross, turn @ cross @ cross

    def fk(self, q: Array) -> tuple[Array, Array]:
        """Rotation [rows][3][3] and position [rows][3] of the tcp of each row of joint values."""
        return self._place(q)[:2]

    def _place(self, q: Array) -> tuple[Array, Array, Array, Array]:
        """As `fk`, and axis and position of every joint, [rows][joints][3]."""
        rows = len(q)
        turn, at = np.broadcast_to(np.eye(3), (rows, 3, 3)), np.zeros((rows, 3))
        axes, places = np.empty((rows, self.count, 3)), np.empty((rows, self.count, 3))
        sine, rest = np.sin(q), 1.0 - np.cos(q)
        for n, (offset, axis, m0, m1, m2) in enumerate(self._joints):
            at = at + turn @ offset
            axes[:, n], places[:, n] = turn @ axis, at
            if self.slides[n]:
                at = at + q[:, n, None] * axes[:, n]
                turn = turn @ m0
            else:
                turn = turn @ (m0 + sine[:, n, None, None] * m1 + rest[:, n, None, None] * m2)
        return turn @ self._tip_turn, at + turn @ self._tip_at, axes, places

    def _jacobian(self, at: Array, axes: Array, places: Array) -> Array:
        """[rows][6][joints], linear above angular, in base axes."""
        jacobian = np.zeros((len(at), 6, self.count))
        (a, b, c), (x, y, z) = axes.transpose(2, 0, 1), (at[:, None] - places).transpose(2, 0, 1)
        jacobian[:, 0], jacobian[:, 1], jacobian[:, 2] = b * z - c * y, c * x - a * z, a * y - b * x  # np.cross is slow
        jacobian[:, 3:] = axes.transpose(0, 2, 1)
        if self.slides.any():
            jacobian[:, :3, self.slides] = axes[:, self.slides].transpose(0, 2, 1)
            jacobian[:, 3:, self.slides] = 0.0
        return jacobian

    def manipulability(self, q: Array) -> Array:
        """sqrt(det(J J')) of each row; 0 in a singularity."""
        _, at, axes, places = self._place(q)
        jacobian = self._jacobian(at, axes, places)
        return np.sqrt(np.maximum(np.linalg.det(jacobian @ jacobian.transpose(0, 2, 1)), 0.0))

    @cached_property
    def _table(self) -> tuple[Array, Array, Array, float]:
        """(postures, positions, rotations as rows of nine, typical manipulability)."""
        q = np.random.default_rng(SEED).uniform(self.lower, self.upper, (TABLE, self.count))
        turn, at = self.fk(q)
        return q, at, turn.reshape(TABLE, 9), float(np.median(self.manipulability(q[:256])))

    # --- search ------------------------------------------------------------------------------------------

    def solutions(self, goal: pin.SE3, reference: Array, margin: Array | float = 0.0) -> list[Array]:
        """Joint values that bring the tcp to the goal, each at least `margin` from its limits; the best first.

        `margin`: rad, m; one, or one by joint.

        The best have a short motion time from `reference`, and are far from limits and singularities.
        """
        found = self._search(goal, reference, self.lower + margin, self.upper - margin)
        beside = self.nearest_ik(goal, reference)
        if beside is not None and (beside >= self.lower + margin).all() and (beside <= self.upper - margin).all():
            found = np.vstack((beside, found))
        if not len(found):
            return []
        if self.count > 6:
            nearest = found[int(np.argmin(self._costs_s(found, reference)))]
            starts = self._self_motions(nearest)
            beside, converged = self._descend(goal, starts, self.lower + margin, self.upper - margin, SELF_STEPS)
            found = np.vstack((found, beside[converged]))
        order = np.argsort(self._costs_s(found, reference), kind="stable")
        return _different(found[order], SAME if self.count <= 6 else APART)

    def without_limits(self, goal: pin.SE3, reference: Array) -> list[Array]:
        """As `solutions`, with every limit wider by its range."""
        reach = np.where(self.slides, 1.0, math.pi)
        found = self._search(goal, reference, self.lower - reach, self.upper + reach)
        return _different(found, SAME)

    def nearest_approach(self, goal: pin.SE3, reference: Array) -> NearestReach:
        """The posture within the limits that comes nearest to a goal out of reach, of those tried."""
        starts = np.vstack((reference, self._nearest(goal, BATCHES[0])))
        q, _ = self._descend(goal, starts, self.lower, self.upper, keep_all=True)
        off = self._errors(goal, *self.fk(q))
        metres, radians = np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1)
        best = int(np.argmin(metres + METRES_PER_RAD * radians))
        return NearestReach(q[best], float(metres[best]), float(radians[best]))

    def nearest_ik(self, goal: pin.SE3, near: Array) -> Array | None:
        """Joint values near `near` that bring the tcp to the goal, regardless of limits; None: not found.

        For small steps along a line. Redundant joints move away from their limits.
        """
        model, data, tcp = self._model, self._data, self._tcp
        q, most = np.array(near, dtype=float), math.inf
        for step in range(FOLLOW_STEPS):
            pin.framesForwardKinematics(model, data, q)
            error = pin.log6(data.oMf[tcp].actInv(goal)).vector
            size = float(error @ error)
            if size < ENOUGH * ENOUGH:
                return q
            if self.count < WHOLE and most < STILL and _near(error):
                return q
            jacobian = pin.computeFrameJacobian(model, data, q, tcp, pin.LOCAL)
            if self._weights is not None:
                jacobian, error = self._weights[:, None] * jacobian, self._weights * error
            if self.count > 6:
                move = self._redundant_step(q, jacobian, error, size, FOLLOW_GAIN if step == 0 else 0.0)
            else:
                move = _least_squares(jacobian, error, size)
            most = float(np.abs(move).max())
            q = q + move * min(1.0, MAX_STEP / max(most, 1e-12))
        return None

    def _redundant_step(self, q: Array, jacobian: Array, error: Array, size: float, gain: float) -> Array:
        """A step in which a joint that would come near its limit stays, as long as six others are left."""
        kept = np.minimum(HELD * (self.upper - self.lower), MAX_HELD)
        away, free = gain * self._away(q[None])[0], np.ones(self.count)
        while True:
            wanted = away * free
            move = wanted + _least_squares(jacobian, error - jacobian @ wanted, size, free)
            beyond = np.maximum(self.lower + kept - q - move, 0.0) * (move < 0.0)
            beyond = (beyond + np.maximum(q + move - self.upper + kept, 0.0) * (move > 0.0)) * free
            if not beyond.any() or free.sum() <= 6:
                return move
            free[int(beyond.argmax())] = 0.0

    def _search(self, goal: pin.SE3, reference: Array, lower: Array, upper: Array) -> Array:
        nearest = self._nearest(goal, sum(BATCHES))
        found = np.empty((0, self.count))
        for first, number, steps in zip((0, BATCHES[0]), BATCHES, STEPS, strict=True):
            starts = nearest[first : first + number]
            if first == 0:  # the middle is among them, so that another reference finds no pose that this one misses
                starts = np.vstack((reference, 0.5 * (self.lower + self.upper), starts))
            q, converged = self._descend(goal, starts, lower, upper, steps)
            found = q[converged]
            if len(found):
                break
        return found

    def _self_motions(self, q: Array) -> Array:
        """Starts beside a posture, along the motions of the arm that hardly move its hand."""
        _, at, axes, places = self._place(q[None])
        null = np.linalg.svd(self._jacobian(at, axes, places)[0])[2][6:]
        starts: Array = (q + np.array(SELF_MOTIONS)[:, None, None] * null).reshape(-1, self.count)
        return starts

    def _nearest(self, goal: pin.SE3, number: int) -> Array:
        """The postures of the table whose tcp is nearest to the goal."""
        q, at, turns, _ = self._table
        cosine = np.clip(0.5 * (turns @ goal.rotation.reshape(9) - 1.0), -1.0, 1.0)
        away = np.sqrt(((at - goal.translation) ** 2).sum(axis=1)) + METRES_PER_RAD * np.arccos(cosine)
        chosen = np.argpartition(away, number)[:number]
        return q[chosen[np.argsort(away[chosen], kind="stable")]]

    def _descend(
        self, goal: pin.SE3, starts: Array, lower: Array, upper: Array, steps: int = STEPS[0], keep_all: bool = False
    ) -> tuple[Array, Array]:
        """(joint values, whether each row has converged). Without `keep_all` it ends when enough have."""
        q = np.clip(starts, lower, upper)
        converged = np.zeros(len(q), dtype=bool)
        moved = np.full(len(q), np.inf)  # in the last step
        for step in range(steps):
            active = np.flatnonzero(~converged)
            here = q[active]
            turn, at, axes, places = self._place(here)
            error = self._errors(goal, turn, at)
            size = (error**2).sum(axis=1)
            done = size < ENOUGH * ENOUGH
            if self.count < WHOLE:
                done |= (moved[active] < STILL) & _near(error)
            converged[active[done]] = True
            if done.all() or (not keep_all and step >= WANTED_STEPS and converged.sum() >= WANTED):
                break
            if not keep_all and step == HOPELESS_STEPS and not converged.any() and size.min() > HOPELESS**2:
                break
            left = ~done
            move = self._step(here[left], error[left], size[left], (at[left], axes[left], places[left]), step)
            q[active[left]] = np.clip(here[left] + move, lower, upper)
            moved[active[left]] = np.abs(q[active[left]] - here[left]).max(axis=1)
        return q, converged

    def _step(self, q: Array, error: Array, size: Array, placed: tuple[Array, Array, Array], step: int) -> Array:
        """One damped step of every row."""
        jacobian = self._jacobian(*placed)
        if self._weights is not None:
            jacobian, error = self._weights[:, None] * jacobian, self._weights * error
        transposed = jacobian.transpose(0, 2, 1)
        squared = jacobian @ transposed
        squared[:, np.arange(6), np.arange(6)] += (DAMPING * size + MIN_DAMPING)[:, None]
        wanted = error
        away = None
        if self.count > 6 and step < NULL_STEPS:
            away = NULL_GAIN * self._away(q)
            wanted = error - (jacobian @ away[:, :, None])[:, :, 0]
        move = (transposed @ np.linalg.solve(squared, wanted[:, :, None]))[:, :, 0]
        if away is not None:
            move += away
        most = np.abs(move).max(axis=1, keepdims=True)
        scaled: Array = move * np.minimum(1.0, MAX_STEP / np.maximum(most, 1e-12))
        return scaled

    def _away(self, q: Array) -> Array:
        """A motion away from the limits: towards the middle of each range, weak there and strong near its ends."""
        half = 0.5 * (self.upper - self.lower)
        off = (q - 0.5 * (self.upper + self.lower)) / half
        moved: Array = -half * np.clip(off, -1.1, 1.1) ** 5
        return moved

    def _errors(self, goal: pin.SE3, turn: Array, at: Array) -> Array:
        """The twist from each tcp to the goal, base axes: m and rad, [rows][6]."""
        rows = np.empty((len(at), 6))
        rows[:, :3] = goal.translation - at
        between = goal.rotation @ turn.transpose(0, 2, 1)
        axis = 0.5 * np.stack(
            (
                between[:, 2, 1] - between[:, 1, 2],
                between[:, 0, 2] - between[:, 2, 0],
                between[:, 1, 0] - between[:, 0, 1],
            ),
            axis=1,
        )
        sine = np.sqrt((axis**2).sum(axis=1))
        cosine = 0.5 * (between[:, 0, 0] + between[:, 1, 1] + between[:, 2, 2] - 1.0)
        angle = np.arctan2(sine, cosine)
        rows[:, 3:] = axis * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 1.0)[:, None]
        # Half a turn away the axis vanishes; any axis leads out of there.
        rows[:, 3] += np.where((sine <= 1e-6) & (cosine < 0.0), 1.0, 0.0)
        return rows

    def _costs_s(self, q: Array, reference: Array) -> Array:
        """Motion time from the reference (s), with penalties near limits and singularities."""
        times = (np.abs(q - reference) / self.velocity).max(axis=1)
        margin = np.minimum((q - self.lower), (self.upper - q)) / (self.upper - self.lower)
        near_limit = np.clip(1.0 - margin.min(axis=1) / NEAR_LIMIT, 0.0, 1.0)
        typical = self._table[3]
        near_singular = np.clip(1.0 - self.manipulability(q) / (NEAR_SINGULAR * typical + 1e-12), 0.0, 1.0)
        penalty = near_limit + near_singular
        costs: Array = times * (1.0 + PENALTY * penalty) + PENALTY_S * penalty
        return costs


def _least_squares(jacobian: Array, error: Array, size: float, weights: Array | None = None) -> Array:
    """The least joint motion for a small twist, each joint by its weight."""
    weighted = jacobian if weights is None else jacobian * weights
    squared = weighted @ jacobian.T
    squared[np.diag_indices(6)] += DAMPING * 0.01 * size + MIN_DAMPING
    move: Array = weighted.T @ np.linalg.solve(squared, error)
    return move


def _near(error: Array) -> Any:
    """Whether a residual twist, or each of several, is as small as that of an arm with few joints may be."""
    metres, radians = np.linalg.norm(error[..., :3], axis=-1), np.linalg.norm(error[..., 3:], axis=-1)
    return (metres < NEAR_M) & (radians < NEAR_RAD)


def _different(rows: Array, apart: float) -> list[Array]:
    """The rows in order, without those nearer than `apart` to an earlier one."""
    found: list[Array] = []
    for q in rows:
        if all(np.abs(q - other).max() > apart for other in found):
            found.append(q)
    return found

"""Numeric inverse kinematics of any arm: damped Gauss-Newton (Levenberg-Marquardt) from several starts.

Deterministic, because the starts have a fixed seed. Slower than the closed form (about 1 ms per start), and it may miss
branches; used only for arms without a closed form.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from rtc.robot.geometry import Array

STARTS = 24  # number of starts
STEPS = 60  # maximum number of iterations per start
ENOUGH = 1e-9  # norm of the residual twist (m and rad) for convergence
SAME = 1e-3  # rad; nearer results count as equal


def branches(model: pin.Model, data: pin.Data, frame: int, goal: pin.SE3, reference: Array) -> list[list[float]]:
    """Joint vectors (rad) within the limits that bring `frame` to `goal`, given in the arm's base frame."""
    random = np.random.default_rng(560)
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    starts = [reference, *random.uniform(lower, upper, (STARTS - 1, model.nq))]
    found: list[Array] = []
    for start in starts:
        q = _descend(model, data, frame, goal, start)
        if q is not None and all(np.abs(q - other).max() > SAME for other in found):
            found.append(q)
    return [q.tolist() for q in found]


def _descend(model: pin.Model, data: pin.Data, frame: int, goal: pin.SE3, start: Array) -> Array | None:
    q, damping = np.clip(start, model.lowerPositionLimit, model.upperPositionLimit), 1e-2
    error = _error(model, data, frame, goal, q)
    for _ in range(STEPS):
        if error @ error < ENOUGH * ENOUGH:
            return q
        jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        normal = jacobian.T @ jacobian + damping * np.eye(model.nv)
        candidate = np.clip(
            q + np.linalg.solve(normal, jacobian.T @ error), model.lowerPositionLimit, model.upperPositionLimit
        )
        trial = _error(model, data, frame, goal, candidate)
        if trial @ trial < error @ error:
            q, error, damping = candidate, trial, max(damping * 0.2, 1e-12)
        else:
            damping *= 8.0
            if damping > 1e6:
                return None
    return q if error @ error < ENOUGH * ENOUGH else None


def _error(model: pin.Model, data: pin.Data, frame: int, goal: pin.SE3, q: Array) -> Array:
    """The twist (tool axes) from the pose of `frame` to the goal."""
    pin.framesForwardKinematics(model, data, q)
    twist: Array = pin.log6(data.oMf[frame].actInv(goal)).vector
    return twist

"""Closed-form inverse kinematics of a PUMA-like arm: an offset shoulder, an elbow, a spherical wrist.

The chain: Rz(q1) Tz(d1) Rx(90) | Rz(q2) Tx(a2) | Rz(q3) Tx(a3) Tz(d3) Rx(-90) | Rz(q4) Tz(d4) Rx(90) |
Rz(q5) Rx(-90) | Rz(q6), from frame 0 at the foot to frame 6 in the wrist.
Up to eight branches: shoulder left or right, elbow up or down, wrist flipped or not. Plain float arithmetic. It ignores
joint limits, base and tool.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import remainder, tau

import numpy as np
from numpy.typing import NDArray

Rows = Sequence[Sequence[float]]  # the upper three rows of a 4x4 matrix
_RX = {s: np.array(((1, 0, 0), (0, 0, -s), (0, s, 0)), dtype=float) for s in (1, -1)}  # Rx(+90), Rx(-90)


@dataclass(frozen=True)
class PumaGeometry:
    """The five lengths (m) of the chain."""

    d1: float
    a2: float
    a3: float
    d3: float
    d4: float

    @property
    def forearm(self) -> float:
        """Distance (m) from the elbow's axis to the wrist's centre."""
        return math.hypot(self.a3, self.d4)


def recognise(placements: list[NDArray[np.float64]]) -> PumaGeometry | None:
    """The lengths, if the six 4x4 joint placements (child joint in parent joint) fit such an arm; else None."""
    if len(placements) != 6:
        return None
    rotations = [np.eye(3), _RX[1], np.eye(3), _RX[-1], _RX[1], _RX[-1]]
    p = [placement[:3, 3] for placement in placements]
    offsets = [(0, 0, 0), (0, 0, p[1][2]), (p[2][0], 0, 0), (p[3][0], 0, p[3][2]), (0, 0, p[4][2]), (0, 0, 0)]
    fits = all(
        np.allclose(placement[:3, :3], rotation, atol=1e-9) and np.allclose(at, offset, atol=1e-9)
        for placement, rotation, at, offset in zip(placements, rotations, p, offsets, strict=True)
    )
    lengths = (float(n) for n in (p[1][2], p[2][0], p[3][0], p[3][2], p[4][2]))  # Python floats are faster
    return PumaGeometry(*lengths) if fits else None


def branches(g: PumaGeometry, flange: Rows, wrist_roll: float) -> list[list[float]]:
    """All joint vectors (rad, each angle in -pi..pi) that put frame 6 at `flange`, given in frame 0.

    If the wrist is straight, only joint 4 + joint 6 is determined; joint 4 becomes `wrist_roll`.
    """
    return [
        [remainder(q, tau) for q in (q1, q2, q3, *wrist)]
        for q1, u, q3 in _shoulders_and_elbows(g, flange)
        for q2, wrists in (_upper_arm_and_wrists(g, flange, q1, u, q3, wrist_roll),)
        for wrist in wrists
    ]


def nearest(g: PumaGeometry, flange: Rows, near: Sequence[float], speeds: Sequence[float]) -> list[float] | None:
    """The branch with the shortest motion time from `near` (rad) at full `speeds` (rad/s), turns nearest to it.

    None: out of reach.
    """
    turned = [
        [q - tau * round((q - to) / tau) for q, to in zip(branch, near, strict=True)]
        for branch in branches(g, flange, near[3])
    ]

    def takes_s(found: list[float]) -> float:
        return max([abs(q - to) / speed for q, to, speed in zip(found, near, speeds, strict=True)])

    return min(turned, key=takes_s, default=None)


def _shoulders_and_elbows(g: PumaGeometry, flange: Rows) -> Iterator[tuple[float, float, float]]:
    """(joint 1, horizontal distance of the wrist with its side, joint 3) of each branch."""
    x, y, z = flange[0][3], flange[1][3], flange[2][3] - g.d1
    radial = x * x + y * y - g.d3 * g.d3
    if radial < 0:
        return
    bend = (radial + z * z - g.a2 * g.a2 - g.forearm**2) / (2 * g.a2 * g.forearm)
    if abs(bend) > 1:
        return
    phase, bend = math.atan2(g.d4, g.a3), math.acos(bend)
    towards = math.atan2(y, x)
    for u in (math.sqrt(radial), -math.sqrt(radial)):
        q1 = towards - math.atan2(-g.d3, u)
        yield q1, u, bend - phase
        yield q1, u, -bend - phase


def _upper_arm_and_wrists(
    g: PumaGeometry, flange: Rows, q1: float, u: float, q3: float, wrist_roll: float
) -> tuple[float, list[tuple[float, float, float]]]:
    """Joint 2, and each (joint 4, joint 5, joint 6) of one shoulder and elbow."""
    (r00, r01, r02, _), (r10, r11, r12, _), (r20, r21, r22, z) = flange
    c1, s1, c3, s3 = math.cos(q1), math.sin(q1), math.cos(q3), math.sin(q3)
    q2 = math.atan2(z - g.d1, u) - math.atan2(g.a3 * s3 + g.d4 * c3, g.a2 + g.a3 * c3 - g.d4 * s3)
    c, s = math.cos(q2 + q3), math.sin(q2 + q3)
    # Rows of R03^T = (x3, y3, z3): x3 along the turned x, y3 against the elbow's axis, z3 along the forearm.
    e00, e01, e02 = c1 * c, s1 * c, s
    e10, e11 = -s1, c1
    e20, e21, e22 = -c1 * s, -s1 * s, c
    w02 = e00 * r02 + e01 * r12 + e02 * r22
    w12 = e10 * r02 + e11 * r12
    w22 = e20 * r02 + e21 * r12 + e22 * r22
    s5 = math.hypot(w02, w12)
    if s5 < 1e-9:  # wrist straight (or, beyond any limit, folded)
        w00 = e00 * r00 + e01 * r10 + e02 * r20
        w10 = e10 * r00 + e11 * r10
        if w22 > 0:
            return q2, [(wrist_roll, 0.0, math.atan2(w10, w00) - wrist_roll)]
        return q2, [(wrist_roll, math.pi, wrist_roll - math.atan2(w10, -w00))]
    w20 = e20 * r00 + e21 * r10 + e22 * r20
    w21 = e20 * r01 + e21 * r11 + e22 * r21
    q4, q5, q6 = math.atan2(-w12, -w02), math.atan2(s5, w22), math.atan2(-w21, w20)
    return q2, [(q4, q5, q6), (q4 + math.pi, -q5, q6 + math.pi)]


def shortfall(g: PumaGeometry, wrist: NDArray[np.float64]) -> tuple[str, float]:
    """(direction, distance in m) by which the wrist's centre, given in frame 0, is out of reach; ("", 0.0) within."""
    x, y, z = wrist.tolist()
    z -= g.d1
    across = math.hypot(x, y)
    if across < abs(g.d3):
        return "too near the shoulder's axis", abs(g.d3) - across
    from_shoulder = math.sqrt(across * across - g.d3 * g.d3 + z * z)
    farthest, nearest = g.a2 + g.forearm, abs(g.a2 - g.forearm)
    if from_shoulder > farthest:
        return "too far from the shoulder", from_shoulder - farthest
    if from_shoulder < nearest:
        return "too near the shoulder", nearest - from_shoulder
    return "", 0.0

"""Poses: seven floats [x y z qx qy qz qw], metres and a unit quaternion, right-handed.

Pure arithmetic, with `math` where numpy would be slower for seven numbers. Each function takes any sequence of floats
and returns a new float64 array (or a float), so that results can be stored, sent and compared. `compose(a, b)`: b is
given in the axes of a; the result is in the frame of a. This module knows no robot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Floats = Sequence[float] | Array  # type of pose and vector arguments

IDENTITY: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

# The attitude in which a vertical bar is straddled: tool z = world +x, tool y = world +y, tool x = world -z.
LEVEL: tuple[float, ...] = (0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5))


def make_pose(position: Floats, quaternion: Floats = (0.0, 0.0, 0.0, 1.0)) -> Array:
    """A pose from a position (m) and a quaternion (xyzw, normalised here)."""
    return normalise((*_floats(position), *_floats(quaternion)))


def normalise(pose: Floats) -> Array:
    """The same pose with a unit quaternion and w >= 0, so that its representation is unique. Raises ValueError."""
    x, y, z, qx, qy, qz, qw = _floats(pose)
    norm = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
    if norm < 1e-9:
        raise ValueError(f"a quaternion of length zero is not an orientation: {[qx, qy, qz, qw]}")
    norm = -norm if qw < 0 else norm
    return np.array((x, y, z, qx / norm, qy / norm, qz / norm, qw / norm))


def compose(a: Floats, b: Floats) -> Array:
    """`b`, given in the axes of `a`, expressed where `a` is expressed."""
    ax, ay, az, *qa = _floats(a)
    bx, by, bz, *qb = _floats(b)
    rx, ry, rz = _turn(qa, bx, by, bz)
    return np.array((ax + rx, ay + ry, az + rz, *_multiply(qa, qb)))


def inverse(a: Floats) -> Array:
    """The pose of the outer frame in the axes of `a`."""
    x, y, z, qx, qy, qz, qw = _floats(a)
    back = (-qx, -qy, -qz, qw)
    rx, ry, rz = _turn(back, x, y, z)
    return np.array((-rx, -ry, -rz, *back))


def relative(frame: Floats, pose: Floats) -> Array:
    """`pose` in the axes of `frame`; `compose(frame, relative(frame, pose))` is `pose` again."""
    return compose(inverse(frame), pose)


def transform_point(pose: Floats, point: Floats) -> Array:
    """A point given in the axes of `pose`, expressed where `pose` is expressed."""
    x, y, z, *q = _floats(pose)
    rx, ry, rz = _turn(q, *_floats(point))
    return np.array((x + rx, y + ry, z + rz))


def rotate(pose: Floats, vector: Floats) -> Array:
    """A direction given in the axes of `pose`, turned but not moved."""
    return np.array(_turn(_floats(pose)[3:], *_floats(vector)))


def translate(pose: Floats, by: Floats) -> Array:
    """`pose` moved by a vector of the outer frame, attitude kept."""
    x, y, z, *q = _floats(pose)
    dx, dy, dz = _floats(by)
    return np.array((x + dx, y + dy, z + dz, *q))


def interpolate_all(a: Floats, b: Floats, fractions: Array) -> Array:
    """The poses at `fractions` (0..1) of the straight line from `a` to `b`, [fractions][7]; attitude by the shorter
    slerp."""
    pa, pb = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    cosine = float(pa[3:] @ pb[3:])
    qb = -pb[3:] if cosine < 0 else pb[3:]  # q and -q are the same attitude; take the nearer one
    wa, wb = 1.0 - fractions, fractions  # linear interpolation where sin(angle) is nearly 0
    poses = np.empty((len(fractions), 7))
    poses[:, :3] = pa[:3] + np.outer(fractions, pb[:3] - pa[:3])
    if abs(cosine) <= 0.99999:
        angle = math.acos(abs(cosine))
        wa, wb = np.sin(wa * angle) / math.sin(angle), np.sin(wb * angle) / math.sin(angle)
    turns = np.outer(wa, pa[3:]) + np.outer(wb, qb)
    norms = np.sqrt((turns * turns).sum(axis=1))
    poses[:, 3:] = turns / np.where(turns[:, 3] < 0, -norms, norms)[:, None]
    return poses


def distance(a: Floats, b: Floats) -> float:
    """Metres between the origins of two poses (or between two points)."""
    return math.dist(_floats(a)[:3], _floats(b)[:3])


def angle(a: Floats, b: Floats) -> float:
    """The angle (rad, 0..pi) of the rotation from the attitude of `a` to that of `b`."""
    x, y, z, w = _multiply([-n for n in _floats(a)[3:6]] + [_floats(a)[6]], _floats(b)[3:])
    return 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(w))


def to_matrix(pose: Floats) -> Array:
    """The 4x4 matrix of a pose."""
    px, py, pz, x, y, z, w = _floats(pose)
    return np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), px),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), py),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), pz),
            (0.0, 0.0, 0.0, 1.0),
        )
    )


def to_matrices(poses: Sequence[Floats] | Array) -> Array:
    """The 4x4 matrices of poses, [poses][4][4]."""
    table = np.asarray(poses, dtype=float)
    px, py, pz, x, y, z, w = table.T
    zero, one = np.zeros(len(table)), np.ones(len(table))
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), px),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), py),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), pz),
        (zero, zero, zero, one),
    )
    return np.array(rows).transpose(2, 0, 1)


def from_matrix(matrix: Array) -> Array:
    """The pose of a 4x4 matrix whose upper left is a rotation."""
    (a, b, c, px), (d, e, f, py), (g, h, i, pz) = np.asarray(matrix, dtype=float)[:3].tolist()
    # Shepperd: divide by the largest of the four, which is never near zero.
    candidates = (1 + a - e - i, 1 - a + e - i, 1 - a - e + i, 1 + a + e + i)
    largest = max(range(4), key=candidates.__getitem__)
    quaternion = (
        (candidates[0], b + d, c + g, h - f),
        (b + d, candidates[1], f + h, c - g),
        (c + g, f + h, candidates[2], d - b),
        (h - f, c - g, d - b, candidates[3]),
    )[largest]
    return normalise((px, py, pz, *quaternion))


def from_rpy(position: Floats, rpy: Floats) -> Array:
    """The pose of a position (m) and roll, pitch, yaw (rad) about the fixed axes x, y, z, as in URDF."""
    roll, pitch, yaw = (0.5 * n for n in _floats(rpy))
    cr, sr, cp, sp, cy, sy = (f(n) for n in (roll, pitch, yaw) for f in (math.cos, math.sin))
    quaternion = (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
    return normalise((*_floats(position), *quaternion))


def to_rpy(pose: Floats) -> Array:
    """Roll, pitch, yaw (rad) about the fixed axes x, y, z; at pitch +-90 deg the yaw is taken to be 0."""
    _, _, _, x, y, z, w = _floats(pose)
    sine = max(-1.0, min(1.0, 2 * (w * y - z * x)))
    if abs(sine) > 1 - 1e-12:
        return np.array((2 * math.atan2(x, w), math.asin(sine), 0.0))
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return np.array((roll, math.asin(sine), math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))))


def rotation_vector(a: Floats, b: Floats) -> Array:
    """The rotation from `a` to `b` as axis times angle (rad), in the outer frame; length at most pi."""
    qa = _floats(a)[3:]
    x, y, z, w = _multiply(_floats(b)[3:], [-qa[0], -qa[1], -qa[2], qa[3]])
    if w < 0:
        x, y, z, w = -x, -y, -z, -w
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < 1e-12 else 2.0 * math.atan2(sine, w) / sine
    return np.array((scale * x, scale * y, scale * z))


def _floats(values: Floats) -> Sequence[float]:
    return values.tolist() if isinstance(values, np.ndarray) else values  # Python floats: 5x faster than numpy's


def _multiply(p: Sequence[float], q: Sequence[float]) -> tuple[float, float, float, float]:
    a, b, c, d = p
    e, f, g, h = q
    return (
        d * e + a * h + b * g - c * f,
        d * f - a * g + b * h + c * e,
        d * g + a * f - b * e + c * h,
        d * h - a * e - b * f - c * g,
    )


def _turn(q: Sequence[float], x: float, y: float, z: float) -> tuple[float, float, float]:
    a, b, c, w = q
    tx, ty, tz = 2 * (b * z - c * y), 2 * (c * x - a * z), 2 * (a * y - b * x)
    return (
        x + w * tx + b * tz - c * ty,
        y + w * ty + c * tx - a * tz,
        z + w * tz + a * ty - b * tx,
    )

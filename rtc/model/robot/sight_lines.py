"""What hides points of the cell from an eye: the pieces of the collision model that a line of sight meets. Pure.

A camera sees the same pieces, so a tag behind one of them is not in its picture.
"""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from rtc.model.robot.levers import ball
from rtc.model.robot.scene_state import SceneState
from rtc.spatial.geometry import Array

END_M = 0.001  # before its point a line of sight ends: a tag lies on its body
THIN_M = 5e-5  # radius of a line
Z = np.array([0.0, 0.0, 1.0])


def hidden_by(state: SceneState, eye: Array, points: Array) -> list[str]:
    """For each point (n x 3, m, world frame) the label of a piece before it, seen from the eye (m); empty: none. Of
    several it is the one whose middle is nearest to the eye.

    `state` has the joints and the scene of this moment. A piece that the eye is in hides nothing: it is that of the
    camera itself."""
    state.place()
    items, placements = state.bodies.geometry.geometryObjects, state.geometry_data.oMg
    solid = [n for n, piece in enumerate(state.bodies.pieces) if piece.kind != "region"]
    balls = {n: ball(items[n].geometry, placements[n]) for n in solid}
    dot, here = coal.Sphere(THIN_M), pin.SE3(np.eye(3), eye)
    found = [""] * len(points)
    for n in sorted(solid, key=lambda n: float(np.linalg.norm(balls[n][0] - eye))):
        shape, at = items[n].geometry, placements[n]
        near = _may_meet(*balls[n], eye, points)
        if not near.any() or _touch(shape, at, dot, here):
            continue
        for k in np.flatnonzero(near).tolist():
            if not found[k] and _touch(shape, at, *_line(eye, points[k])):
                found[k] = state.bodies.pieces[n].label
    return found


def _may_meet(middle: Array, radius_m: float, eye: Array, points: Array) -> Array:
    """Of each line whether it meets the ball around a shape."""
    ways = points - eye
    share = np.clip(((middle - eye) * ways).sum(axis=1) / (ways**2).sum(axis=1), 0.0, 1.0)
    near: Array = np.linalg.norm(eye + share[:, None] * ways - middle, axis=1) <= radius_m + THIN_M
    return near


def _line(eye: Array, point: Array) -> tuple[coal.Capsule, pin.SE3]:
    way = point - eye
    length_m = float(np.linalg.norm(way))
    seen_m = length_m - END_M
    turn = pin.Quaternion.FromTwoVectors(Z, way / length_m).toRotationMatrix()
    return coal.Capsule(THIN_M, seen_m), pin.SE3(turn, eye + 0.5 * seen_m / length_m * way)


def _touch(a: coal.ShapeBase, at: pin.SE3, b: coal.ShapeBase, bt: pin.SE3) -> bool:
    places = (coal.Transform3s(one.rotation, one.translation) for one in (at, bt))
    first, second = places
    return bool(coal.collide(a, first, b, second, coal.CollisionRequest(), coal.CollisionResult()))

"""Propagation of pose uncertainty: through rigid offsets, measurements and motions in the hand. Pure.

A spread is six half-widths: x y z (m), roll pitch yaw (rad), in the axes of the pose.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from rtc.model.cells.parts import Numbers
from rtc.spatial import geometry
from rtc.spatial.geometry import Floats
from rtc.world.spread import Spread, even, narrowest, widened

EARTH_M_S2 = 9.81


def spread_at(spread: Spread, offset: Floats) -> list[float]:
    """Spread of the pose at `offset` (in the first pose's axes), rigidly joined to a pose of this spread.

    A small error [d, r] of the first pose is the error [turn (d + r x offset), turn r] there. In plain numbers, because
    an array of nine costs more than its products."""
    x, y, z = (float(n) for n in offset[:3])
    dx, dy, dz, rx, ry, rz = map(float, spread)
    metres, radians = [], []
    for a, b, c in geometry.to_matrix(offset)[:3, :3].T.tolist():
        lever = abs(c * y - b * z) * rx + abs(a * z - c * x) * ry + abs(b * x - a * y) * rz
        metres.append(abs(a) * dx + abs(b) * dy + abs(c) * dz + lever)
        radians.append(abs(a) * rx + abs(b) * ry + abs(c) * rz)
    return metres + radians


def error_of(pose: Floats, true: Floats) -> list[float]:
    """How far a pose is from another one, along and about its own axes, to be compared with its spread."""
    turned = geometry.rotate(geometry.inverse(pose), geometry.rotation_vector(pose, true))
    return [*geometry.relative(pose, true)[:3].tolist(), *turned.tolist()]


def spread_after_measurement(
    before: Floats, after: Floats, spread: Spread, at: Floats, measured: Mapping[int, float]
) -> list[float]:
    """Spread of a frame that a measurement moved from `before` to `after` (world frame).

    `at`: the measured pose, in the frame's axes. `measured`: axis of that pose (0 to 5: x y z roll pitch yaw) ->
    half-width of the measurement. Axes that were not measured keep their spread.
    """
    there = _after_move(spread_at(spread, at), geometry.compose(before, at), geometry.compose(after, at))
    for axis, half_width in measured.items():
        there[axis] = half_width
    return narrowest(spread_at(there, geometry.inverse(at)), _after_move(spread, before, after))


def _after_move(spread: Spread, before: Floats, after: Floats) -> list[float]:
    """Spread of a pose that is believed at `after` now, and had this spread at `before` (world frame)."""
    moved = geometry.relative(before, after)
    by = [*(abs(n) for n in geometry.inverse(moved)[:3].tolist()), *(abs(n) for n in geometry.to_rpy(moved).tolist())]
    turned = np.abs(geometry.to_matrix(moved)[:3, :3].T)
    bounds = np.asarray(spread, dtype=float)
    return widened([*(turned @ bounds[:3]).tolist(), *(turned @ bounds[3:]).tolist()], by)


def unsure_across(spread: Spread, at: Floats, axis: int) -> float:
    """The larger half-width (rad) of the pose `at`, in a frame of this spread, about the two axes beside this one."""
    angles = spread_at(spread, at)[3:]
    return max(angles[n] for n in range(3) if n != axis)


def uncertainty_figures(spread: Spread, at: Floats) -> dict[str, float]:
    """Spread of the pose `at` (in the axes of a frame of this spread), as figures of a script."""
    x, y, z, *angles = spread_at(spread, at)
    return {"unsure_x_m": x, "unsure_y_m": y, "unsure_z_m": z, "unsure_rad": max(angles)}


def askew_spread(spread: Spread, grasp: Floats, wider_m: float, pad_m: float) -> list[float]:
    """Spread of a held object after the fingers have moved by `wider_m`: its bar, which is `pad_m` deep, has turned
    between the pads, about the bar (tool x) or about the approach (tool z).

    `grasp`: the frame of the object in the axes of the tcp."""
    turn_rad = abs(wider_m) / pad_m
    return widened(spread, spread_at([0.0, 0.0, 0.0, turn_rad, 0.0, turn_rad], grasp))


def crept_spread(spread: Spread, moved_s: float, numbers: Numbers) -> list[float]:
    """Spread of an object whose hand has moved for `moved_s` more: it creeps in the grip. At rest it does not."""
    return widened(spread, even(moved_s * numbers.creep_m_s, moved_s * numbers.creep_rad_s))


def tipped_spread(
    spread: Spread, before: Floats, after: Floats, gravity: Floats, values: Mapping[str, float]
) -> list[float]:
    """Spread of a held object after its hand has turned from one pose to another: its weight pulls it another way
    through the springs of the fingers. `tipped_m` and `tipped_rad` are for a weight that comes from the side."""
    pulls = [geometry.rotate(geometry.inverse(pose), gravity) for pose in (before, after)]
    share = float(np.linalg.norm(pulls[1] - pulls[0])) / EARTH_M_S2
    return widened(spread, even(share * values["tipped_m"], share * values["tipped_rad"]))


def struck_spread(spread: Spread, grasp: Floats, peak_force_n: float, values: Mapping[str, float]) -> list[float]:
    """Spread of a held object after a motion. A force above `twisted_n` turns it between the pads about the closing
    direction (tool y), and by half of that about the bar (tool x). One above `struck_n` displaces it.

    `grasp`: the frame of the object in the axes of the tcp."""
    found = list(spread)
    if peak_force_n > values["struck_n"]:
        found = widened(found, even(values["struck_m"], values["struck_rad"]))
    if peak_force_n > values["twisted_n"]:
        turn_rad = values["twisted_rad"]
        found = widened(found, spread_at([0.0, 0.0, 0.0, 0.5 * turn_rad, turn_rad, 0.0], grasp))
    return found


def rolled_spread(spread: Spread, axis: Floats, rolled_m: float, most_m: float, lever_m: float) -> list[float]:
    """Spread of an object with a hinge after its hand has turned it.

    Its bar rolls between the pads by up to `rolled_m`. A bar cannot be farther than `most_m` aside, however often it
    rolls. `axis`: of the hinge, in the object's axes. `lever_m`: from the hinge to the bar.
    """
    more, most = (abs(rolled / lever_m) for rolled in (rolled_m, most_m))
    return [
        *spread[:3],
        *(max(now, min(now + more * abs(n), most * abs(n))) for now, n in zip(spread[3:], axis, strict=True)),
    ]

"""Poses of objects from the corners of their tags, by least squares over all pictures at once. Pure.

One tag alone has two poses that explain its picture nearly as well (a plane seen from afar may be tilted to either
side). Both are kept as starts of the search, and the second is part of the result if it fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rtc.sensing.optics import CORNERS, CameraView
from rtc.spatial.geometry import Array, from_matrix, rotation_vector

STEPS = 25  # of the search, maximum
SMALL = 1e-6  # m and rad: a step below this ends the search
STARTS = 2  # number of tags, the largest, that give the starts
NOISE_PX = 0.2  # standard deviation of a corner that is assumed at least, per axis
BAD_PX = 1.0  # above this error, a tag is looked for that is not where the cell states
MIN_GAIN = 3.0  # such a tag is left out if the error of the others is lower by this factor
APART_RAD, APART_M = 0.035, 0.005  # poses further apart are two solutions
CONFUSED = 2.0  # a second solution whose error is below this multiple of the first cannot be ruled out


class TagObservation(NamedTuple):
    """One tag of a body in one picture. `points`: its corners in the axes of the body, 4 x 3, m."""

    tag: int
    view: CameraView
    pixels: Array
    points: Array


class Solution(NamedTuple):
    """`matrix`: 4 x 4, body to world. `error_px`: root mean square over both axes of all corners."""

    matrix: Array
    error_px: float


class Fit(NamedTuple):
    """The pose of a body. `covariance`: 6 x 6, of the position and of a small turn about the body's origin, world
    axes, m and rad. It covers the second solution if that cannot be ruled out."""

    best: Solution
    second: Solution | None
    covariance: Array
    used: list[TagObservation]

    @property
    def pose(self) -> Array:
        return from_matrix(self.best.matrix)

    @property
    def noise(self) -> Array:
        """The covariance without the choice between two solutions: how far poses of one body at rest scatter."""
        if self.second is None or not self.ambiguous:
            return self.covariance
        return self.covariance - between(self.best, self.second)

    @property
    def ambiguous(self) -> bool:
        return self.second is not None and self.second.error_px < CONFUSED * max(self.best.error_px, NOISE_PX)


def fit(sightings: Sequence[TagObservation], near: Array | None = None) -> Fit | None:
    """The pose that explains all sightings of a body. None if there is not one, or none leads to a pose in front of
    the cameras. `near`: 4 x 4, an expected pose; it is used as the start if it leads to one that fits."""
    used, solutions = list(sightings), _from_expected(sightings, near)
    if not solutions:
        used, solutions = _consistent(used)
    if not solutions:
        return None
    best = solutions[0]
    second = next((other for other in solutions[1:] if _apart(best.matrix, other.matrix)), None)
    made = Fit(best, second, _covariance(used, best), used)
    if second is None or not made.ambiguous:
        return made
    return made._replace(covariance=made.covariance + between(best, second))


def planar(sighting: TagObservation) -> list[Solution]:
    """The one or two poses of a body that explain the picture of one of its tags, the better one first."""
    first = _from_homography(sighting)
    if first is None:
        return []
    starts = [first, _mirrored(sighting, first)]
    found = [solution for start in starts if (solution := _refined([sighting], start)) is not None]
    found.sort(key=lambda solution: solution.error_px)
    if len(found) == 2 and not _apart(found[0].matrix, found[1].matrix):
        del found[1]
    return found


def _solutions(sightings: Sequence[TagObservation]) -> list[Solution]:
    """Local minima over all sightings, best first, from the poses that the largest tags alone allow."""
    largest = sorted(sightings, key=lambda sighting: -area_px(sighting.pixels))[:STARTS]
    starts = [solution for sighting in largest for solution in planar(sighting)]
    if len(sightings) == 1:
        return starts
    different: list[Solution] = []
    for start in sorted(starts, key=lambda start: start.error_px):
        if not any(not _apart(start.matrix, other.matrix) for other in different):
            different.append(start)
    found = [solution for start in different if (solution := _refined(sightings, start.matrix)) is not None]
    return sorted(found, key=lambda solution: solution.error_px)


def _from_expected(sightings: Sequence[TagObservation], near: Array | None) -> list[Solution]:
    """The solutions from an expected pose, and from that with the largest tag tilted to the other side; best first.
    Empty if neither fits."""
    if near is None or not sightings:
        return []
    first = _refined(sightings, near)
    if first is None or first.error_px > BAD_PX:
        return []
    largest = max(sightings, key=lambda sighting: area_px(sighting.pixels))
    other = _refined(sightings, _mirrored(largest, first.matrix))
    return sorted([first, *([other] if other is not None else [])], key=lambda solution: solution.error_px)


def _consistent(sightings: list[TagObservation]) -> tuple[list[TagObservation], list[Solution]]:
    """The sightings without those that contradict the others, and the solutions over the rest."""
    solutions = _solutions(sightings)
    while solutions and solutions[0].error_px > BAD_PX and len(sightings) >= 3:
        rests = [sightings[:n] + sightings[n + 1 :] for n in range(len(sightings))]
        tried = [(rest, found) for rest in rests if (found := _solutions(rest))]
        if not tried:
            break
        rest, found = min(tried, key=lambda one: one[1][0].error_px)
        if MIN_GAIN * found[0].error_px > solutions[0].error_px:
            break
        sightings, solutions = rest, found
    return sightings, solutions


def area_px(pixels: Array) -> float:
    """Of a polygon, n x 2 pixels."""
    x, y = pixels.T
    return float(0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


# --- starts --------------------------------------------------------------------------------------------


def _plane(points: Array) -> Array:
    """Matrix 4 x 4 of the tag's axes in the body: x to the right, y up, z out of the surface."""
    right, up = points[1] - points[0], points[3] - points[0]
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1] = right / np.linalg.norm(right), up / np.linalg.norm(up)
    matrix[:3, 2] = np.cross(matrix[:3, 0], matrix[:3, 1])
    matrix[:3, 3] = points.mean(axis=0)
    return matrix


def _from_homography(sighting: TagObservation) -> Array | None:
    """Body to world by the homography of the tag's four corners. None if the corners do not allow one."""
    view = sighting.view
    half = 0.5 * float(np.linalg.norm(sighting.points[1] - sighting.points[0]))
    seen = (sighting.pixels - view.centre_px) / view.focal_px
    rows = []
    for (x, y, _), (u, v) in zip(half * CORNERS, seen, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y, -u], [0, 0, 0, x, y, 1, -v * x, -v * y, -v]]
    homography = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    scale = 0.5 * float(np.linalg.norm(homography[:, 0]) + np.linalg.norm(homography[:, 1]))
    if scale < 1e-12:
        return None
    homography /= scale if homography[2, 2] > 0.0 else -scale
    columns = np.column_stack([*homography.T[:2], np.cross(homography[:, 0], homography[:, 1])])
    left, _, right = np.linalg.svd(columns)
    tag = np.eye(4)
    tag[:3, :3] = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    tag[:3, 3] = homography[:, 2]
    return _to_world(view, tag) @ np.linalg.inv(_plane(sighting.points))


def _mirrored(sighting: TagObservation, matrix: Array) -> Array:
    """The body turned so that the tag is tilted to the other side of the line of sight."""
    plane = _plane(sighting.points)
    tag = matrix @ plane
    eye = -sighting.view.rotation.T @ sighting.view.translation
    sight = (eye - tag[:3, 3]) / np.linalg.norm(eye - tag[:3, 3])
    normal = tag[:3, 2]
    other = 2.0 * (normal @ sight) * sight - normal
    tag[:3, :3] = _turn_between(normal, other) @ tag[:3, :3]
    return tag @ np.linalg.inv(plane)


def _turn_between(a: Array, b: Array) -> Array:
    """The least rotation from one unit vector to another that is not opposite."""
    axis = _skew(np.cross(a, b))
    turn: Array = np.eye(3) + axis + axis @ axis / max(1.0 + float(a @ b), 1e-9)
    return turn


def _to_world(view: CameraView, matrix: Array) -> Array:
    world = np.eye(4)
    world[:3, :3] = view.rotation.T @ matrix[:3, :3]
    world[:3, 3] = view.rotation.T @ (matrix[:3, 3] - view.translation)
    return world


# --- least squares -------------------------------------------------------------------------------------


class _Corners(NamedTuple):
    """All corners of some sightings, one row each."""

    points: Array  # n x 3, m, body
    rotations: Array  # n x 3 x 3, world to camera
    translations: Array  # n x 3
    focal_px: Array  # n
    targets: Array  # n x 2: pixels from the centre of the picture

    def seen(self, matrix: Array) -> Array:
        """In the axes of the cameras, n x 3."""
        world = self.points @ matrix[:3, :3].T + matrix[:3, 3]
        found: Array = np.einsum("nij,nj->ni", self.rotations, world) + self.translations
        return found

    def residuals(self, seen: Array) -> Array:
        """Pixels, 2 per corner."""
        off: Array = self.focal_px[:, None] * seen[:, :2] / seen[:, 2:] - self.targets
        return off.reshape(-1)

    def slopes(self, matrix: Array, seen: Array) -> Array:
        """Of the residuals over position and small turn, world axes: 6 columns."""
        arms = self.points @ matrix[:3, :3].T
        lens = np.zeros((len(seen), 2, 3))
        lens[:, 0, 0] = lens[:, 1, 1] = 1.0
        lens[:, :, 2] = -seen[:, :2] / seen[:, 2:]
        lens *= (self.focal_px / seen[:, 2])[:, None, None]
        by_position = lens @ self.rotations
        by_turn = np.cross(arms[:, None, :], by_position)  # d(turn x arm) = -arm x d(turn)
        slopes: Array = np.concatenate([by_position, by_turn], axis=2).reshape(-1, 6)
        return slopes


def _corners(sightings: Sequence[TagObservation]) -> _Corners:
    views = [sighting.view for sighting in sightings]
    return _Corners(
        np.concatenate([sighting.points for sighting in sightings]),
        np.repeat([view.rotation for view in views], 4, axis=0),
        np.repeat([view.translation for view in views], 4, axis=0),
        np.repeat([view.focal_px for view in views], 4),
        np.concatenate([sighting.pixels - sighting.view.centre_px for sighting in sightings]),
    )


def _refined(sightings: Sequence[TagObservation], matrix: Array) -> Solution | None:
    """Levenberg-Marquardt from `matrix`. None if a corner is behind its camera."""
    corners = _corners(sightings)
    seen = corners.seen(matrix)
    if not _in_front(seen):
        return None
    damping, residuals = 1e-4, corners.residuals(seen)
    for _ in range(STEPS):
        slopes = corners.slopes(matrix, seen)
        normal = slopes.T @ slopes
        step = _step(normal, damping, slopes.T @ residuals)
        moved = _moved(matrix, step)
        ahead = corners.seen(moved)
        if _in_front(ahead) and _rms(trial := corners.residuals(ahead)) <= _rms(residuals):
            matrix, seen, residuals, damping = moved, ahead, trial, 0.1 * damping
            if float(np.abs(step).max()) < SMALL:
                break
        elif damping > 1e8:
            break
        else:
            damping *= 10.0
    return Solution(matrix, _rms(residuals))


def _step(normal: Array, damping: float, gradient: Array) -> Array:
    step: Array = -np.asarray(
        np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), gradient), np.float64
    )
    return step


def _in_front(seen: Array) -> bool:
    return bool(np.all(seen[:, 2] > 0.01))


def _moved(matrix: Array, step: Array) -> Array:
    moved = matrix.copy()
    moved[:3, 3] += step[:3]
    moved[:3, :3] = _rotation(step[3:]) @ matrix[:3, :3]
    return moved


def _rotation(vector: Array) -> Array:
    """Rotation by a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    axis = _skew(vector / angle)
    turn: Array = np.eye(3) + np.sin(angle) * axis + (1.0 - np.cos(angle)) * axis @ axis
    return turn


def _skew(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _rms(residuals: Array) -> float:
    return float(np.sqrt(np.mean(np.square(residuals))))


def _covariance(sightings: Sequence[TagObservation], solution: Solution) -> Array:
    corners = _corners(sightings)
    slopes = corners.slopes(solution.matrix, corners.seen(solution.matrix))
    freedom = max(1, len(slopes) - 6)
    noise_px = max(NOISE_PX, solution.error_px * (len(slopes) / freedom) ** 0.5)
    covariance: Array = noise_px**2 * np.linalg.pinv(slopes.T @ slopes)
    return covariance


def _difference(a: Array, b: Array) -> Array:
    """Position (m) and rotation vector (rad) from a to b, world axes."""
    return np.concatenate([b[:3, 3] - a[:3, 3], rotation_vector(from_matrix(a), from_matrix(b))])


def _apart(a: Array, b: Array) -> bool:
    between = _difference(a, b)
    return bool(np.linalg.norm(between[:3]) > APART_M or np.linalg.norm(between[3:]) > APART_RAD)


def between(a: Solution, b: Solution) -> Array:
    """Covariance of a choice between two solutions, as that of a `Fit`."""
    off = _difference(a.matrix, b.matrix)
    return np.outer(off, off)

"""A way round obstacles by sampling, for the case that the direct ways are not free: search, shorten, round off. Pure.

`sampling` searches; this module defines what is free in a planning request. The corners of the path found are rounded,
and `request.fault` judges it as any other path. With an attitude to keep, each step of the search is projected onto it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from msgspec.structs import replace

from rtc.model.robot.boxes import Growth
from rtc.model.robot.collision import line
from rtc.model.robot.kinematics import MIN_WEIGHT
from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats
from workers.planning.motion import path as paths
from workers.planning.motion.blended import lengths, widest
from workers.planning.motion.path import CHECK_RAD, Path
from workers.planning.motion.request import FreeWay, PlanningRequest, fault, free_posture, is_free
from workers.planning.motion.sampling import (
    MIN_RAD,
    NARROW,
    REACH_RAD,
    VAIN,
    WIDE,
    Draw,
    Found,
    GrowingTrees,
    Trees,
    search,
    shorten,
    size,
)

SAMPLES = 4000  # budget of all searches for one way
WIDE_SAMPLES = 1000  # of them, of the first search; the rest is for one that finds out of a narrow place
ROOMY_SAMPLES = 80  # budget of the search with more room, before that
LONG = 2.0  # times the length of a line: a way with an attitude that is longer is sought again
SEARCHES = 10  # for one way, the first one included; four of ten find a short one round a panel
ATTEMPTS = 3  # maximum number of ways found, of which the finer check rejects all but the last
MORE_M = 0.002  # clearance of the search beyond that of the request
JUDGED_RAD = 0.012  # step of the final check: shortened ways pass obstacles closely, so it is finer than `CHECK_RAD`
OUTER = 0.4  # weight in distances of the joints that move the hand least; that of the others is between it and 1
BACK = 0.85  # share of the free part of a blocked line after which its node is set, away from the obstacle
PROJECTED_RAD = 0.25  # weighted length of a step between two projections
AWAY = 0.5  # a projected step must make this share of its length towards its end
RAISED_AND_BACK_M = ((0.15, 0.0), (0.0, 0.15), (0.3, 0.15))  # of the first samples
NARROWER = 8  # maximum number of halvings of a corner's radius, in the mean of all corners
MIN_RADIUS = 0.002  # rad; a corner as narrow as this follows the lines within a millimetre


def find_way_aside(request: PlanningRequest, goal: Array, guides: Sequence[Array]) -> FreeWay | None:
    """A way by both ends moved aside, if one is free. `guides`: of `guides`."""
    for by_m, guided in _detours(request, goal, guides):
        if is_free(request, guided):
            words = "by way of both ends, raised by {:g} m and drawn back by {:g} m".format(*by_m)
            return FreeWay(guided, [f"modified: {words}; tested: free"])
    return None


def find_sampled_way(
    request: PlanningRequest, roomy: PlanningRequest, goals: Sequence[Floats], guides: Sequence[Array]
) -> FreeWay | int:
    """A rounded way to one of `goals` (rad), which are free; or the number of samples without a result.

    `roomy`: the request with more clearance, or the same. The search keeps that at first, and then less. `guides`: of
    `guides`, to the first goal."""
    ends = [np.asarray(goal, dtype=float) for goal in goals]
    drawn = 0
    for attempt, asked in enumerate([roomy, *[_with_some_room(request, ends)] * ATTEMPTS]):
        if attempt == 0 and roomy is request:
            continue
        seed = ATTEMPTS * request.seed + max(0, attempt - 1)
        samples = ROOMY_SAMPLES if attempt == 0 else max(0, min(SAMPLES, WIDE_SAMPLES) - drawn)
        space = _Space(asked)
        found = space.search(ends, seed, samples, guides if attempt < 2 else ())
        if not isinstance(found, Found):
            drawn += found
            if attempt == 0:
                continue
            found = space.search(ends, seed, max(0, SAMPLES - drawn), draw=NARROW)
        if not isinstance(found, Found):
            return drawn + found
        drawn += found.samples
        corners = space.shortest(ends, found, seed)
        way = rounded(request, corners) or rounded(request, found.waypoints)
        if way is not None:
            words = f"by way of {len(way.knots) - 2} points, found with {drawn} samples of seed {seed}"
            return FreeWay(way, [f"modified: {words}; tested: free"])
    return drawn


def guides(request: PlanningRequest, goal: Array) -> list[Array]:
    """Postures with the hand raised, drawn back, or both, from the start and from the goal in turn. In a cell with
    racks and bays they often suffice."""
    lower, upper = _limits(request)
    found = []
    for up_m, back_m in RAISED_AND_BACK_M:
        for end in (request.start, goal):
            by_m = _moved(request.arm.fk(end), up_m, back_m)
            found.append(np.clip(request.arm.moved_by(by_m, end), lower, upper))
    return found


def _limits(request: PlanningRequest) -> tuple[Array, Array]:
    """Lower and upper joint limits (rad) of a way; its start is within them."""
    limits, margin = request.arm.limits, request.arm.margins(request.way_margin_rad)
    return np.minimum(limits.lower + margin, request.start), np.maximum(limits.upper - margin, request.start)


def _detours(request: PlanningRequest, goal: Array, guides: Sequence[Array]) -> Iterator[tuple[Floats, Path]]:
    """Ways by both ends moved aside, which often suffice; they keep no attitude."""
    if request.path_constraints.attitude is None:
        for by_m, first, second in zip(RAISED_AND_BACK_M, guides[::2], guides[1::2], strict=True):
            yield by_m, paths.through([request.start, first, second, goal])


def _moved(pose: Array, up_m: float, back_m: float) -> Array:
    """The displacement (m, world) of a hand that is raised, and drawn back along its own axis."""
    return geometry.rotate(pose, (0.0, 0.0, -back_m)) + np.array((0.0, 0.0, up_m))


def _with_some_room(request: PlanningRequest, goals: Sequence[Array]) -> PlanningRequest:
    """The request with `MORE_M` of clearance to spare for the checks between those of the search, if the ends allow."""
    wider = replace(request, scene=replace(request.scene, clearance_m=request.scene.clearance_m + MORE_M))
    test = free_posture(wider)
    return wider if all(test(q) is None for q in (request.start, *goals)) else request


class _Space:
    """What is free in a request, as a `Steer` of the search."""

    def __init__(self, request: PlanningRequest) -> None:
        self._request = request
        self.limits = _limits(request)
        steps = request.arm.step_weights
        self.weights = OUTER + (1.0 - OUTER) * (steps - MIN_WEIGHT) / (1.0 - MIN_WEIGHT)
        self._per_rad = steps / CHECK_RAD  # as `Path.dense`
        self._start = request.start
        self._touches_at_start = free_posture(request)(self._start) is not None
        self._attitude = None if request.path_constraints.attitude is None else request.path_constraints.attitude.pose

    def search(
        self, goals: Sequence[Array], seed: int, samples: int, guides: Sequence[Array] = (), draw: Draw = WIDE
    ) -> Found | int:
        """As `sampling.search`, from the start to these goals.

        Compiled trees do not leave an end that is nearly too near to a body, because they do not ask coal."""
        trees, ends = self.trees(goals), np.vstack([self._start, *goals])
        found = search(trees, ends, *self.limits, seed=seed, samples=samples, guides=guides, draw=draw)
        if isinstance(found, Found) or isinstance(trees, Trees) or trees.have_grown():
            return found
        more = self._trees_in_python(goals)
        return search(more, ends, *self.limits, seed=seed, samples=samples, guides=guides, draw=draw)

    def shortest(self, goals: Sequence[Array], found: Found, seed: int) -> list[Array]:
        """The way found, shortened. One that keeps an attitude and is much longer than a line may have gone the wrong
        way round: then the shortest of further searches."""
        best = shorten(found.waypoints, found.steer, self.weights, seed=seed)
        for n in range(1, SEARCHES if self._attitude is not None else 1):
            if self._size(best) <= LONG * self._length(best[-1] - best[0]):
                break
            more = self.search(goals, seed + n * ATTEMPTS, SAMPLES, draw=NARROW)
            if isinstance(more, Found):
                best = min(best, shorten(more.waypoints, more.steer, self.weights, seed=seed), key=self._size)
        return best

    def _size(self, corners: list[Array]) -> float:
        return sum(self._length(after - before) for before, after in pairwise(corners))

    def trees(self, goals: Sequence[Array]) -> GrowingTrees:
        """The trees of a search: compiled if boxes prove the ends free and can judge a way alone."""
        request = self._request
        if not self._touches_at_start and request.path_constraints.work_range is None:
            growth = Growth(REACH_RAD, MIN_RAD, BACK, VAIN, PROJECTED_RAD, AWAY)
            weights = np.vstack((self.weights, self._per_rad))
            limits = np.vstack(self.limits)
            compiled = request.world.trees(
                request.arm, goals, request.joints, request.scene, limits, weights, growth, self._attitude
            )
            if compiled is not None:
                return compiled
        return self._trees_in_python(goals)

    def _trees_in_python(self, goals: Sequence[Array]) -> Trees:
        steer = self._straight if self._attitude is None else self._projected
        return Trees(self._start, goals, steer, self.weights, self.project)

    def project(self, q: Array) -> Array | None:
        """The posture, turned to the attitude to keep; None: not found within the joint limits."""
        if self._attitude is None:
            return q
        turned = self._request.arm.turned_to(self._attitude, q)
        lower, upper = self.limits
        return turned if turned is not None and bool((turned >= lower).all() and (turned <= upper).all()) else None

    def _straight(self, here: Array, there: Array) -> tuple[list[Array], bool]:
        share = self._free_share(here, there)
        if share >= 1.0:
            return [there.copy()], True
        return ([here + share * (there - here)] if share > 0 else []), False

    def _free_share(self, here: Array, there: Array) -> float:
        """The free share of a line in joint space, 0 to 1."""
        request, steps = self._request, self._steps(here, there)
        world, arm, joints, scene = request.world, request.arm.name, request.joints, request.scene
        if self._from_a_touch(here):
            hit = world.check_path(arm, line(here, there, steps), joints, scene)
            free = steps + 1 if hit is None else hit.index
        else:
            # the first node of a blocked line would be nearer than a tree takes
            vain = 1 + min(steps - 1, MIN_RAD / BACK * steps / max(self._length(there - here), MIN_RAD))
            free = world.line_free_until(arm, here, there, steps, joints, scene, int(vain))
        free = self._in_range(here, there, steps, free)
        return 1.0 if free > steps else BACK * max(0, free - 1) / steps

    def _steps(self, here: Array, there: Array) -> int:
        """The number of steps of collision checks on a line in joint space."""
        return max(1, math.ceil(size(there - here, self._per_rad)))

    def _from_a_touch(self, here: Array) -> bool:
        """Whether the line leaves a contact that exists at the start."""
        return self._touches_at_start and np.array_equal(here, self._start)

    def _in_range(self, here: Array, there: Array, steps: int, free: int) -> int:
        """Of the first `free` postures of a line the number of those before the first that leaves the work range. An
        attitude holds between two near postures that keep it."""
        request = self._request
        if request.path_constraints.work_range is None:
            return free
        rows = line(here, there, steps)[:free]
        broken = (n for n, q in enumerate(rows) if request.path_constraints.violation(request.arm, q) is not None)
        return next(broken, free)

    def _projected(self, here: Array, there: Array) -> tuple[list[Array], bool]:
        """In short steps, each projected onto the attitude to keep."""
        chain: list[Array] = []
        left = self._length(there - here)
        while left > PROJECTED_RAD:
            onward = here + (PROJECTED_RAD / left) * (there - here)
            step = self.project(onward)
            if step is None:
                return chain, False
            remains = self._length(there - step)
            too_far = self._length(step - here) > 2 * PROJECTED_RAD
            if too_far or remains > left - AWAY * PROJECTED_RAD or self._free_share(here, step) < 1.0:
                return chain, False
            chain.append(step)
            here, left = step, remains
        if self._free_share(here, there) < 1.0:
            return chain, False
        return [*chain, there.copy()], True

    def _length(self, way: Array) -> float:
        return size(way, self.weights)


def rounded(request: PlanningRequest, corners: list[Array]) -> Path | None:
    """The way-points with rounded corners, each halved while the path near it is not free. None: not found."""
    corners = [*paths.distinct_postures(corners)]
    radii = widest(lengths(np.array(corners)))
    for _ in range(NARROWER * len(corners)):
        way = paths.through(corners, radii)
        problem = fault(request, way, JUDGED_RAD)
        if problem is None:
            return way
        if len(corners) == 2:
            return None
        at = problem.fraction * way.length
        nearest = int(np.argmin(np.maximum(np.abs(way.s[1:-1] - at) - radii, 0.0)))
        if radii[nearest] < MIN_RADIUS:
            return None
        radii[nearest] *= 0.5
    return None

"""Collision checks of arms, held objects and the rest of the cell.

A `CollisionWorld` checks joint values in a scene (`rtc.model.robot.collision_scene`). Reuse one scene for many checks:
setting it up takes about 0.2 ms, a check 7-40 us. The result names the two bodies. Geometry only: the caller decides
which contacts are intended.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rtc.model.cells import cell as cells
from rtc.model.robot import sight_lines
from rtc.model.robot.boxes import STRAIGHT, Growth
from rtc.model.robot.coal_groups import CoalGroups, Part, Parts
from rtc.model.robot.collision_scene import AS_BUILT, Scene, same_places
from rtc.model.robot.kinematics import ArmModel
from rtc.model.robot.scene_state import Collision, SceneState
from rtc.model.robot.separation import SeparationCheck
from rtc.spatial.geometry import Array, Floats

if TYPE_CHECKING:
    from rtc.model.robot._boxes import Trees


@dataclass(frozen=True)
class PathCollision:
    index: int  # of the first configuration in collision
    collision: Collision


class Approach(NamedTuple):
    """A link of an arm, or what it holds, and a body near it."""

    link: str
    body: str
    distance_m: float
    point: Array  # the nearest one of the body (m, world)
    away: list[float]  # unit vector from the body to the link (world)
    joints: tuple[int, int]  # the first joint that moves the one against the other, and the first that does not


NOTHING: Part = (0, 1, [])  # the part before a path

TURNING_STEPS = 4  # interpolation steps between configurations while an attached object turns
LEAVING_STEPS = 10  # interpolation steps between configurations while an initial contact lasts
GROUP = 3  # steps of a path that one check of coal may prove free
HALVED = 1e-3  # share of a step: how exactly the place is found where a pair begins to be too near
MIN_M = 2e-5  # by which a pair may come nearer between two measured distances at least
PROBES = 7  # configurations of a path that may show at once that it is blocked
STRIDE = 4  # configurations between two measurements of the room along a path
DEEPER_M = 0.0002  # tolerance for noise of joint values and of penetration depths


class CollisionWorld:
    """The bodies of one cell. Not thread-safe: it keeps the last scene."""

    def __init__(self, cell: cells.Cell, *, boxes: bool = True) -> None:
        """`boxes`: the compiled proof comes before coal, where it is installed; without it coal decides everything."""
        self.cell = cell
        self.cell_digest = cell.digest()
        self._state = SceneState(cell, boxes=boxes)
        self._groups = CoalGroups(self._state)  # in place of boxes
        self._apart: SeparationCheck | None = None  # made when it is first needed

    def check(self, joints: Mapping[str, Floats], scene: Scene = AS_BUILT) -> Collision | None:
        """The first pair found that is too near, or None. `joints`: rad, of all arms. Raises ValueError."""
        self._state.update(joints, scene)
        if scene.attached:
            self._state.turn_attached(scene)
        return self._state.ask()

    def check_path(
        self,
        arm: str,
        configurations: Sequence[Floats] | Array,
        others: Mapping[str, Floats],
        scene: Scene = AS_BUILT,
        off: Array = STRAIGHT,
    ) -> PathCollision | None:
        """The first configuration of an arm in collision, or None. `others`: joints (rad) of the arms at rest. `off`:
        how far the path may be off the line between two configurations, [configurations - 1][joints]; or empty.

        A pair that is too near at the start may separate: along the path its distance must not decrease by more than
        `DEEPER_M`. After separation it is checked like all others. So a world model with an error of millimetres can
        start a path in contact, but a path never moves deeper into contact.

        Boxes around the bodies prove most of the path free (`rtc.model.robot.boxes`). Elsewhere the pairs that they
        leave undecided are followed by their distances. So the whole path is free, not only the configurations
        (decision 0081). Of a collision between two configurations the later one is returned.
        """
        if not len(configurations):
            return None
        if scene.attached:
            return self._first_while_turning(arm, configurations, others, scene, off)
        self._state.update({**others, arm: configurations[0]}, scene)
        slots, rows = self._state.bodies.arms[arm].joints, np.asarray(configurations, dtype=float)
        leaving: dict[int, float] = {}  # pair -> greatest distance so far
        index, parts = 1, self._parts(slots, rows, GROUP, off)
        part = parts(1) if len(rows) > 1 else NOTHING
        if part[1] >= len(rows) > 1 and not part[2]:
            return None
        try:
            self._state.q[slots] = rows[0]
            leaving.update(self._let_leave() if self._state.touches_any() else {})
            while index < len(rows):
                first, last, near = part if index == 1 else parts(index)
                if leaving:  # step by step; the pairs that leave are followed by `_at`
                    near = [pair for pair in near if pair not in leaving] if first < index else []
                    first, last = index - 1, index + 1
                found = self._first_too_near(slots, rows[first:last], near, off[first : last - 1]) if near else None
                if found is not None:
                    place, pair = found
                    self._put(slots, rows[first:last], place)
                    hit = self._state.describe(pair)
                    if not self._touched_at(slots, rows[0], pair, hit, leaving):
                        return PathCollision(first + math.ceil(place), hit)
                    index = first + 1  # the other pairs of this step once more
                    continue
                if not leaving:
                    index = last
                    continue
                left = self._at(slots, rows, index, leaving)
                if left is not None:
                    return PathCollision(index, left)
                index += 1
        finally:
            for pair in leaving:
                self._state.count_again(pair)
        return None

    def proves(self, arm: str, path: Array, others: Mapping[str, Floats], scene: Scene, off: Array) -> bool:
        """Whether boxes alone prove that `check_path` finds no collision, which is quick."""
        if self._state.boxes is None or scene.attached or len(path) < 2:
            return False
        self._state.update({**others, arm: path[0]}, scene)
        return not self._state.boxes.way(self._state.q, self._state.bodies.arms[arm].joints, path, 0, off)[1]

    def probe(
        self, arm: str, path: Array, others: Mapping[str, Floats], scene: Scene = AS_BUILT
    ) -> PathCollision | None:
        """A collision, only if `check_path` would find one. A few configurations are checked, spread over the path."""
        if scene.attached:
            return None
        self._state.update({**others, arm: path[0]}, scene)
        slots = self._state.bodies.arms[arm].joints
        for n in _halfway(len(path)):
            self._state.q[slots] = path[n]
            if self._state.touches_any():
                pair = self._state.hit
                found = self._state.describe(pair)
                self._state.q[slots] = path[0]
                self._state.place()
                if self._state.distance_m(pair) > max(float(self._state.pairs.margin[pair]), 0.0):
                    return PathCollision(n, found)  # it is no contact at the start, which may last
        return None

    def free_until(self, arm: str, configurations: Array, others: Mapping[str, Floats], scene: Scene = AS_BUILT) -> int:
        """The index of the first configuration in collision; their number if all are free.

        As `check_path`, but a contact at the start counts, and the bodies are not determined: for a search that makes
        thousands of checks. Of a contact in the first step the index may be 0 or 1.
        """
        if scene.attached:
            hit = self._first_while_turning(arm, configurations, others, scene)
            return len(configurations) if hit is None else hit.index
        self._state.update({**others, arm: configurations[0]}, scene)
        slots = self._state.bodies.arms[arm].joints
        return self._until(slots, configurations, self._parts(slots, configurations, GROUP))

    def line_free_until(
        self,
        arm: str,
        start: Array,
        end: Array,
        steps: int,
        others: Mapping[str, Floats],
        scene: Scene = AS_BUILT,
        first: int = 1,
    ) -> int:
        """`free_until` of a line in joint space in equal steps. Of a collision at the configuration `first` this is the
        result, which costs least; there may be another one before it."""
        slots = self._state.bodies.arms[arm].joints
        if not scene.attached:
            self._state.update({**others, arm: start + (first / steps) * (end - start)}, scene)
            if self._state.touches_any():
                return first
        if self._state.boxes is None or scene.attached:
            return self.free_until(arm, line(start, end, steps), others, scene)
        free, near = self._state.boxes.line(self._state.q, slots, start, end, steps)
        if not near:
            return steps + 1
        rows = line(start, end, steps)
        return self._until(slots, rows, self._parts(slots, rows, GROUP), (free, free + 2, near))

    def _until(self, slots: list[int], rows: Array, parts: Parts, part: Part = NOTHING) -> int:
        """`free_until` from this part on, which is known already."""
        while True:
            first, last, near = part
            if near and last - first == 2 and self._any_too_near(slots, rows[first:last], near):
                return first + 1  # wherever on this step it begins
            if near and (found := self._first_too_near(slots, rows[first:last], near)):
                return first + math.ceil(found[0])
            if last >= len(rows):
                return last
            part = parts(last)

    def trees(
        self,
        arm: ArmModel,
        goals: Sequence[Array],
        joints: Mapping[str, Floats],
        scene: Scene,
        limits: Array,
        weights: Array,
        growth: Growth,
        attitude: Floats | None,
    ) -> Trees | None:
        """Compiled trees for a search from `joints` (rad) to these goals, as long as no other scene is used.

        Only what boxes prove is free to them. None: without the kernel, or if it does not prove an end free.
        `limits`, `weights`, `growth`: as for `Boxes.trees`. `attitude`: of the tcp (world), which all postures keep."""
        if self._state.boxes is None or scene.attached:
            return None
        self._state.update(joints, scene)
        projection, slots = arm.projection(attitude), self._state.bodies.arms[arm.name].joints
        return self._state.boxes.trees(self._state.q, slots, goals, limits, weights, growth, projection)

    def space(self, arm: str, path: Array, scene: Scene) -> Array | None:
        """Boxes in the axes of the world around the pieces of an arm and of what it holds, on its whole path (rad).

        [pieces][6]: low corner, high corner (m). The hand counts as open. None without the compiled kernel."""
        if self._state.boxes is None:
            return None
        if self._state.scene is None or not same_places(self._state.scene, scene):
            self._state.arrange(scene)
        pieces = np.flatnonzero(self._state.table.carriers(scene) == self._state.table.number[arm]).tolist()
        slots, q = self._state.bodies.arms[arm], self._state.q.copy()
        q[slots.fingers] = 0.5 * self.cell.arm(arm).gripper.max_opening_m
        return self._state.boxes.space(q, slots.joints, path, pieces)

    def compare_arms(self, arm: str, other: str, scene: Scene) -> SeparationCheck:
        """Checks of the distance between two arms, each with what it holds in this scene. Both hands count as open."""
        if scene is not self._state.scene:
            self._state.arrange(scene)
        table, carrier = self._state.table, self._state.table.carriers(scene)
        one, two = carrier == table.number[arm], carrier == table.number[other]
        between = np.flatnonzero(table.between(one, two))
        pairs = np.column_stack((table.first[between], table.second[between]))
        pairs = np.where(one[pairs[:, :1]], pairs, pairs[:, ::-1])
        openings_m = {name: self.cell.arm(name).gripper.max_opening_m for name in self._state.bodies.arms}
        self._apart = self._apart or SeparationCheck(self._state)
        self._apart.compare(arm, other, pairs, openings_m)
        return self._apart

    def deepest_contact(self, name: str, joints: Mapping[str, Floats]) -> Collision | None:
        """The nearest pair of a body and any other as the cell begins; None if the body has no pair."""
        self._state.update(joints, AS_BUILT)
        self._state.place()
        pairs = np.flatnonzero(self._state.table.touches([name]) & ~self._state.table.with_region).tolist()
        found = [self._state.describe(pair) for pair in pairs]
        return min(found, key=lambda collision: collision.distance_m, default=None)

    def hidden_by(self, joints: Mapping[str, Floats], scene: Scene, eye: Array, points: Array) -> list[str]:
        """For each point (n x 3, m) the label of a piece before it, seen from the eye (m); empty: none."""
        self._state.update(joints, scene)
        return sight_lines.hidden_by(self._state, eye, points)

    def radius_m(self, name: str) -> float:
        """Radius of a ball around the origin of a seat, object or region that contains it; 0 without shapes."""
        return self._state.radius_m.get(name, 0.0)

    def near(self, arm: str, joints: Mapping[str, Floats], scene: Scene) -> list[Approach]:
        """All pairs of a link of this arm, or of what it holds, and another body that are nearer than the clearance of
        the scene; also of what it holds and its own links."""
        self._state.update(joints, scene)
        table = self._state.table
        mine = table.carriers(scene) == table.number[arm]
        load = mine & (table.owner != table.number[arm])
        wanted = table.between(mine, ~mine) | table.between(load, mine & ~load)
        return [self._approach(arm, n) for n in self._state.hits() if wanted[n]]

    def _approach(self, arm: str, pair: int) -> Approach:
        """A pair of which an arm moves one body, or the one more than the other."""
        nearest, bodies = self._state.nearest(pair), self._state.bodies
        counts = [self._state.joints_before(arm, piece) for piece in bodies.pairs[pair]]
        last = 0 if counts[0] > counts[1] else 1
        link, body = (bodies.pieces[bodies.pairs[pair][n]] for n in (last, 1 - last))
        sign = 1.0 if last else -1.0
        return Approach(
            link.part if link.kind == "arm" else link.label,
            body.label,
            nearest.distance_m,
            nearest.points[1 - last],
            (sign * nearest.normal).tolist(),
            (counts[1 - last], counts[last]),
        )

    def too_near(self, joints: Mapping[str, Floats], scene: Scene) -> list[Collision]:
        """All pairs that are nearer than their clearance in the scene."""
        self._state.update(joints, scene)
        if not self._state.touches_any():
            return []
        return [self._state.describe(pair) for pair in self._state.hits()]

    def least_room(
        self, arm: str, configurations: Array, others: Mapping[str, Floats], scene: Scene, hit: PathCollision
    ) -> PathCollision:
        """Where along a path, from a hit on, its two bodies are nearest to each other, or deepest in one another.

        Every `STRIDE`-th configuration is measured, and those around the nearest of them.
        """
        self._state.update({**others, arm: configurations[0]}, scene)
        table, slots = self._state.table, self._state.bodies.arms[arm].joints
        bodies_of = (table.matching(name) for name in (hit.collision.body_a, hit.collision.body_b))
        pairs = np.flatnonzero(table.between(*bodies_of) & self._state.pairs.active).tolist()
        found: dict[int, Collision] = {}

        def measure(rows: Iterable[int]) -> int:
            for n in rows:
                if n not in found:
                    self._state.q[slots] = configurations[n]
                    if scene.attached:
                        self._state.turn_attached(scene)
                    self._state.place()
                    found[n] = min(map(self._state.describe, pairs), key=lambda one: one.distance_m)
            return min(found, key=lambda n: found[n].distance_m)

        near = measure([*range(hit.index, len(configurations), STRIDE), len(configurations) - 1])
        near = measure(range(max(hit.index, near - STRIDE + 1), min(len(configurations), near + STRIDE)))
        return PathCollision(near, found[near])

    # --- inside ------------------------------------------------------------------------------------------

    def _first_while_turning(
        self,
        arm: str,
        configurations: Sequence[Floats] | Array,
        others: Mapping[str, Floats],
        scene: Scene,
        off: Array = STRAIGHT,
    ) -> PathCollision | None:
        """As `check_path`, with objects that turn about their hinges. A contact at the start counts."""
        self._state.update({**others, arm: configurations[0]}, scene)
        slots, rows = self._state.bodies.arms[arm].joints, np.asarray(configurations, dtype=float)
        for index in range(len(rows)):
            self._state.q[slots] = rows[index]
            self._state.turn_attached(scene)
            if hit := self._state.ask():
                return PathCollision(index, hit)
            if found := self._too_near_while_turning(slots, rows[index : index + 2], off[index : index + 1], scene):
                return PathCollision(index + 1, found)
        return None

    def _too_near_while_turning(self, slots: list[int], step: Array, off: Array, scene: Scene) -> Collision | None:
        """What is too near on a step of `_first_while_turning`. What hangs is checked at `TURNING_STEPS` places of it:
        the levers of a hand and of what turns with it bound their distance too badly for a proof."""
        if len(step) < 2:
            return None
        _, _, near = self._parts(slots, step, 1, off)(1)
        attached = self._state.table.touches(scene.attached)
        found = self._first_too_near(slots, step, [pair for pair in near if not attached[pair]], off)
        if found is not None:
            self._put(slots, step, found[0])
            return self._state.describe(found[1])
        for n in range(1, TURNING_STEPS):
            self._put(slots, step, n / TURNING_STEPS)
            if hit := self._state.ask():
                return hit
        return None

    def _at(self, slots: list[int], rows: Array, index: int, leaving: dict[int, float]) -> Collision | None:
        """What is wrong with one configuration of a path and with the way to it; `leaving` is brought up to date."""
        self._state.q[slots] = rows[index]
        hit = self._state.ask()
        while hit is not None and self._touched_at(slots, rows[0], self._state.hit, hit, leaving):
            self._state.q[slots] = rows[index]
            hit = self._state.ask()
        return hit or self._left(slots, rows[index - 1], rows[index], leaving)

    def _parts(self, slots: list[int], rows: Array, group: int, off: Array = STRAIGHT) -> Parts:
        """As `CoalGroups.parts`, by boxes if there are any."""
        if self._state.boxes is None:
            return self._groups.parts(slots, rows, group, off)
        boxes = self._state.boxes

        def part(index: int) -> Part:
            free, near = boxes.way(self._state.q, slots, rows, index - 1, off)
            return (free, free + 2, near) if near else (free, free + 1, near)

        return part

    def _first_too_near(
        self, slots: list[int], rows: Array, pairs: list[int], off: Array = STRAIGHT
    ) -> tuple[float, int] | None:
        """Where on the way along these configurations a pair may be nearer than its margin: (number of the
        configuration, with a fraction between two; pair)."""
        levers = self._state.levers_of_pairs(slots)[pairs]
        steps = levers @ np.abs(rows[1:] - rows[:-1]).T
        reach = np.hstack((np.zeros((len(pairs), 1)), np.cumsum(steps, axis=1))).tolist()
        nearer = levers @ off.max(axis=0) if len(off) else np.zeros(len(pairs))
        least = np.maximum(self._state.pairs.margin[pairs], 0.0) + nearer
        found: tuple[float, int] | None = None
        for pair, far, margin in zip(pairs, reach, least.tolist(), strict=True):
            last = math.inf if found is None else found[0]
            place = self._where_too_near(slots, rows, pair, far, margin, last)
            if place is not None and (found is None or (place, pair) < found):
                found = place, pair
        return found

    def _any_too_near(self, slots: list[int], rows: Array, pairs: list[int]) -> bool:
        """Whether one of these pairs is nearer than its margin at the last configuration."""
        if not pairs:
            return False
        self._state.q[slots] = rows[-1]
        self._state.place()
        return any(self._state.distance_m(pair) < max(float(self._state.pairs.margin[pair]), 0.0) for pair in pairs)

    def _where_too_near(
        self, slots: list[int], rows: Array, pair: int, reach: list[float], margin: float, last: float
    ) -> float | None:
        """`_first_too_near` of one pair, as far as the place `last`. `reach`: how much nearer it can be at each
        configuration than at the first.

        What its distance exceeds its margin by is free on the way, as far as the pair can come nearer by that. A single
        step at whose end the pair is too near is halved: a slow approach would take a hundred such measurements."""

        def room_at(place: float) -> float:
            self._put(slots, rows, place)
            return self._state.distance_m(pair) - margin

        if len(rows) == 2 and room_at(near := min(1.0, last)) < 0.0:
            free = 0.0
            while near - free > HALVED:
                middle = 0.5 * (free + near)
                free, near = (free, middle) if room_at(middle) < 0.0 else (middle, near)
            return 0.0 if free == 0.0 and room_at(free) < 0.0 else near
        at = 0.0
        while True:
            n = min(bisect_right(reach, at), len(reach) - 1)
            width = reach[n] - reach[n - 1]
            place = n - 1 + ((at - reach[n - 1]) / width if width > 0.0 else 0.0)
            if place > last:
                return None  # another pair is too near before
            if (room := room_at(place)) < 0.0:
                return place
            if at + room >= reach[-1]:
                return None
            at = at + room if room > MIN_M else min(at + MIN_M, reach[n])

    def _put(self, slots: list[int], rows: Array, place: float) -> None:
        """Moves all pieces to a place on the way along these configurations."""
        n = min(int(place), len(rows) - 2)
        self._state.q[slots] = rows[n] + (place - n) * (rows[n + 1] - rows[n])
        if self._state.scene is not None and self._state.scene.attached:
            self._state.turn_attached(self._state.scene)
        self._state.place()

    def _let_leave(self) -> dict[int, float]:
        """The pairs that are too near at the present configuration, with distances (m); `_ask` skips them."""
        leaving = {n: self._state.distance_m(n) for n in self._state.hits()}
        for pair in leaving:
            self._state.leave_out(pair)
        return leaving

    def _touched_at(
        self, slots: list[int], start: Floats, pair: int, hit: Collision, leaving: dict[int, float]
    ) -> bool:
        """True if the pair of a hit was in contact at the start too; it may separate then.

        coal misses some pairs of boxes with coplanar faces, and finds them one millimetre later.
        """
        self._state.q[slots] = start
        self._state.place()
        start_m = self._state.distance_m(pair)
        if start_m > max(float(self._state.pairs.margin[pair]), 0.0) or hit.distance_m < start_m - DEEPER_M:
            return False
        leaving[pair] = hit.distance_m
        self._state.leave_out(pair)
        return True

    def _left(self, slots: list[int], before: Floats, after: Floats, leaving: dict[int, float]) -> Collision | None:
        """`_nearer_again` between two configurations, in steps that are too small to pass through a thin bar."""
        way, together = np.asarray(after, dtype=float) - np.asarray(before, dtype=float), len(leaving)
        for n in range(1, LEAVING_STEPS + 1):
            self._state.q[slots] = before + n / LEAVING_STEPS * way
            self._state.place()
            hit = self._nearer_again(leaving)
            if hit is not None:
                return hit
        return self._state.ask() if len(leaving) < together else None

    def _nearer_again(self, leaving: dict[int, float]) -> Collision | None:
        """The first of these pairs whose distance has decreased; separated pairs return to the normal check."""
        for pair, greatest_m in list(leaving.items()):
            distance_m = self._state.distance_m(pair)
            if distance_m < greatest_m - DEEPER_M:
                return self._state.describe(pair)
            leaving[pair] = max(greatest_m, distance_m)
            if distance_m > max(float(self._state.pairs.margin[pair]), 0.0) + DEEPER_M:
                del leaving[pair]
                self._state.count_again(pair)
        return None


def line(start: Array, end: Array, steps: int) -> Array:
    """A line in joint space in equal steps, [steps + 1][joints]."""
    rows: Array = start + (np.arange(steps + 1) / steps)[:, None] * (end - start)
    return rows


@cache
def _halfway(count: int) -> list[int]:
    """At most `PROBES` numbers below `count`: the middle, the middles of both halves, and so on."""
    places = (odd * count // parts for parts in (2, 4, 8) for odd in range(1, parts, 2))
    return list(dict.fromkeys(places))[:PROBES]

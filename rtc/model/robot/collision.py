"""Collision checks of arms, held objects and the rest of the cell.

A `CollisionWorld` checks joint values in a scene (`rtc.model.robot.collision_scene`). Reuse one scene for many checks:
setting it up takes about 0.2 ms, a check 7-40 us. The result names the two bodies. Geometry only: the caller decides
which contacts are intended.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import coal
import numpy as np
import pinocchio as pin

from rtc.model.cells import cell as cells
from rtc.model.robot import bodies
from rtc.model.robot.boxes import STRAIGHT, Growth, boxes_of
from rtc.model.robot.collision_pairs import Pairs, PairTable
from rtc.model.robot.collision_scene import AS_BUILT, Scene, in_hands, same_places
from rtc.model.robot.kinematics import ArmModel
from rtc.model.robot.levers import ball, levers, of_pairs
from rtc.model.robot.separation import SeparationCheck
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.spatial import hinges
from rtc.spatial.geometry import Array, Floats

if TYPE_CHECKING:
    from rtc.model.robot._boxes import Trees


@dataclass(frozen=True)
class Collision:
    """Two bodies in contact or nearer than the clearance. A negative distance is the penetration depth."""

    body_a: str
    body_b: str
    distance_m: float
    point: tuple[float, float, float]  # world frame, midway between the nearest points
    margin_m: float = 0.0  # the clearance of this pair

    def refusal(self, where: str = "") -> Refusal:
        verb, needed = "collides with", ""
        if self.distance_m > 0:
            verb, needed = f"comes within {_mm(self.distance_m)} of", f" ({_mm(self.margin_m)} needed)"
        return Refusal(
            reason=RefusalReason.INFEASIBLE,
            message=f"{self.body_a} {verb} {self.body_b}{needed}" + (f" {where}" if where else ""),
            where=where,
            clears=f"another goal: {self.body_b.split()[0]} is in the way",
            detail={
                "cause": "collision",
                "body_a": self.body_a,
                "body_b": self.body_b,
                "distance_m": self.distance_m,
                "margin_m": self.margin_m,
                "x_m": self.point[0],
                "y_m": self.point[1],
                "z_m": self.point[2],
            },
        )


def _mm(metres: float) -> str:
    return f"{math.floor(1e4 * metres + 1e-6) / 10:g} mm"  # never more than there is


@dataclass(frozen=True)
class PathCollision:
    index: int  # of the first configuration in collision
    collision: Collision


#: configurations [first, last) of a path, and the pairs that may be too near on the way along them
Part = tuple[int, int, list[int]]
Parts = Callable[[int], Part]
NOTHING: Part = (0, 1, [])  # the part before a path

TURNING_STEPS = 4  # interpolation steps between configurations while a hung object turns
LEAVING_STEPS = 10  # interpolation steps between configurations while an initial contact lasts
GROUP = 3  # steps of a path that one check of coal may prove free
HALVED = 1e-3  # share of a step: how exactly the place is found where a pair begins to be too near
MIN_M = 2e-5  # by which a pair may come nearer between two measured distances at least
FEW = 5  # pairs that are followed along a group
SECTION = 120  # configurations of a path with the same wider margins
PROBES = 7  # configurations of a path that may show at once that it is blocked
STRIDE = 4  # configurations between two measurements of the room along a path
WIDER_M = 1e-4  # tolerance of distances in the check of a group
KEPT_SCENES = 64  # maximum number of scenes whose active pairs and margins are kept
DEEPER_M = 0.0002  # tolerance for noise of joint values and of penetration depths


class _WiderMargins:
    """A second set of margins for the pairs of a scene."""

    def __init__(self, made: bodies.Bodies) -> None:
        self._bodies = made
        self._data = made.geometry.createData()
        self._manager = pin.BroadPhaseManager_NaiveCollisionManager(made.model, made.geometry, self._data)
        self._callback = pin.CollisionCallBackDefault(made.geometry, self._data, True)
        self._pairs: Pairs | None = None

    def put_in_force(self, pairs: Pairs, margins: np.ndarray) -> None:
        """The active pairs of a scene, with these margins (m) [piece][piece]."""
        if pairs is not self._pairs:
            self._data.setActiveCollisionPairs(self._bodies.geometry, pairs.active_matrix)
            self._pairs = pairs
        self._data.setSecurityMargins(self._bodies.geometry, margins)

    def touch(self, data: pin.Data, q: Array) -> bool:
        """Whether any pair is nearer than its margin."""
        return bool(pin.computeCollisions(self._bodies.model, data, self._manager, self._callback, q))

    def pairs_within(self, data: pin.Data, q: Array) -> list[int]:
        """The pairs that are nearer than their margin."""
        found: list[int] = []
        touch = self.touch(data, q)
        while touch:
            found.append(self._callback.collisionPairIndex)
            self._data.deactivateCollisionPair(found[-1])
            touch = pin.computeCollisions(self._manager, self._callback)
        for pair in found:
            self._data.activateCollisionPair(pair)
        return found


class CollisionWorld:
    """The bodies of one cell. Not thread-safe: it keeps the last scene."""

    def __init__(self, cell: cells.Cell, *, boxes: bool = True) -> None:
        """`boxes`: the compiled proof comes before coal, where it is installed; without it coal decides everything."""
        self.cell = cell
        self.cell_digest = cell.digest()
        self._bodies = bodies.build(cell)
        self._data = self._bodies.model.createData()
        self._geometry_data = self._bodies.geometry.createData()
        # The naive one is the fastest of pinocchio's broad phases here (70 boxes: 18 us; tree 49 us, pair list 300 us).
        self._manager = pin.BroadPhaseManager_NaiveCollisionManager(
            self._bodies.model, self._bodies.geometry, self._geometry_data
        )
        self._callback = pin.CollisionCallBackDefault(self._bodies.geometry, self._geometry_data, True)
        self._hit = 0  # the pair that a check has found
        self._left_out: set[int] = set()  # pairs that no check finds
        self._wider = _WiderMargins(self._bodies)  # in place of boxes: prove that a group of configurations is free
        self._q = pin.neutral(self._bodies.model)
        self._places = {name: np.array(slots.joints) for name, slots in self._bodies.arms.items()}
        self._varying: list[int] = []  # joints of the arms that the scene checks
        self._scene: Scene | None = None
        self._placed: dict[str, tuple[str, list[float]]] = {}  # body -> the arm that holds it, and its pose there
        self._elsewhere: dict[str, tuple[int, pin.SE3]] = {}  # bodies that coal has not yet: parent joint, pose there
        self._pairs_of_coal: Pairs | None = None  # the pairs that coal has
        self._pairs_of_scene: dict[tuple[object, ...], Pairs] = {}  # by all that `PairTable.of_scene` reads
        self._pair_levers: dict[int, Array] = {}  # by the first joint of an arm
        self._apart: SeparationCheck | None = None  # made when it is first needed
        self._table = PairTable(self._bodies)
        self._measure_bodies()
        self._boxes = boxes_of(self._bodies, self._levers) if boxes else None
        self._put_in_force(self._table.of_scene(AS_BUILT))
        self._arrange(AS_BUILT)

    def check(self, joints: Mapping[str, Floats], scene: Scene = AS_BUILT) -> Collision | None:
        """The first pair found that is too near, or None. `joints`: rad, of all arms. Raises ValueError."""
        self._set(joints, scene)
        if scene.hung:
            self._turn_hung(scene)
        return self._ask()

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
        if scene.hung:
            return self._first_while_turning(arm, configurations, others, scene, off)
        self._set({**others, arm: configurations[0]}, scene)
        slots, rows = self._bodies.arms[arm].joints, np.asarray(configurations, dtype=float)
        leaving: dict[int, float] = {}  # pair -> greatest distance so far
        index, parts = 1, self._parts(slots, rows, GROUP, off)
        part = parts(1) if len(rows) > 1 else NOTHING
        if part[1] >= len(rows) > 1 and not part[2]:
            return None
        try:
            self._q[slots] = rows[0]
            leaving.update(self._let_leave() if self._touches_any() else {})
            while index < len(rows):
                first, last, near = part if index == 1 else parts(index)
                if leaving:  # step by step; the pairs that leave are followed by `_at`
                    near = [pair for pair in near if pair not in leaving] if first < index else []
                    first, last = index - 1, index + 1
                found = self._first_too_near(slots, rows[first:last], near, off[first : last - 1]) if near else None
                if found is not None:
                    place, pair = found
                    self._put(slots, rows[first:last], place)
                    hit = self._describe(pair)
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
                self._count_again(pair)
        return None

    def proves(self, arm: str, path: Array, others: Mapping[str, Floats], scene: Scene, off: Array) -> bool:
        """Whether boxes alone prove that `check_path` finds no collision, which is quick."""
        if self._boxes is None or scene.hung or len(path) < 2:
            return False
        self._set({**others, arm: path[0]}, scene)
        return not self._boxes.way(self._q, self._bodies.arms[arm].joints, path, 0, off)[1]

    def probe(
        self, arm: str, path: Array, others: Mapping[str, Floats], scene: Scene = AS_BUILT
    ) -> PathCollision | None:
        """A collision, only if `check_path` would find one. A few configurations are checked, spread over the path."""
        if scene.hung:
            return None
        self._set({**others, arm: path[0]}, scene)
        slots = self._bodies.arms[arm].joints
        for n in _halfway(len(path)):
            self._q[slots] = path[n]
            if self._touches_any():
                pair = self._hit
                found = self._describe(pair)
                self._q[slots] = path[0]
                self._place()
                if self._distance_m(pair) > max(float(self._pairs.margin[pair]), 0.0):
                    return PathCollision(n, found)  # it is no contact at the start, which may last
        return None

    def free_until(self, arm: str, configurations: Array, others: Mapping[str, Floats], scene: Scene = AS_BUILT) -> int:
        """The index of the first configuration in collision; their number if all are free.

        As `check_path`, but a contact at the start counts, and the bodies are not determined: for a search that makes
        thousands of checks. Of a contact in the first step the index may be 0 or 1.
        """
        if scene.hung:
            hit = self._first_while_turning(arm, configurations, others, scene)
            return len(configurations) if hit is None else hit.index
        self._set({**others, arm: configurations[0]}, scene)
        slots = self._bodies.arms[arm].joints
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
        slots = self._bodies.arms[arm].joints
        if not scene.hung:
            self._set({**others, arm: start + (first / steps) * (end - start)}, scene)
            if self._touches_any():
                return first
        if self._boxes is None or scene.hung:
            return self.free_until(arm, line(start, end, steps), others, scene)
        free, near = self._boxes.line(self._q, slots, start, end, steps)
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
        if self._boxes is None or scene.hung:
            return None
        self._set(joints, scene)
        projection, slots = arm.projection(attitude), self._bodies.arms[arm.name].joints
        return self._boxes.trees(self._q, slots, goals, limits, weights, growth, projection)

    def space(self, arm: str, path: Array, scene: Scene) -> Array | None:
        """Boxes in the axes of the world around the pieces of an arm and of what it holds, on its whole path (rad).

        [pieces][6]: low corner, high corner (m). The hand counts as open. None without the compiled kernel."""
        if self._boxes is None:
            return None
        if self._scene is None or not same_places(self._scene, scene):
            self._arrange(scene)
        pieces = np.flatnonzero(self._table.carriers(scene) == self._table.number[arm]).tolist()
        slots, q = self._bodies.arms[arm], self._q.copy()
        q[slots.fingers] = 0.5 * self.cell.arm(arm).gripper.max_opening_m
        return self._boxes.space(q, slots.joints, path, pieces)

    def compare_arms(self, arm: str, other: str, scene: Scene) -> SeparationCheck:
        """Checks of the distance between two arms, each with what it holds in this scene. Both hands count as open."""
        if scene is not self._scene:
            self._arrange(scene)
        carrier = self._table.carriers(scene)
        one, two = carrier == self._table.number[arm], carrier == self._table.number[other]
        openings_m = {name: self.cell.arm(name).gripper.max_opening_m for name in self._bodies.arms}
        self._tell_coal()
        self._apart = self._apart or SeparationCheck(self._bodies)
        self._apart.compare(arm, other, (one, two), self._levers, openings_m)
        return self._apart

    def deepest_contact(self, name: str, joints: Mapping[str, Floats]) -> Collision | None:
        """The nearest pair of a body and any other as the cell begins; None if the body has no pair."""
        self._set(joints, AS_BUILT)
        self._place()
        pairs = np.flatnonzero(self._table.touches([name]) & ~self._table.with_region).tolist()
        found = [self._describe(pair) for pair in pairs]
        return min(found, key=lambda collision: collision.distance_m, default=None)

    def radius_m(self, name: str) -> float:
        """Radius of a ball around the origin of a seat, object or region that contains it; 0 without shapes."""
        return self._radius_m.get(name, 0.0)

    def near(self, arm: str, joints: Mapping[str, Floats], scene: Scene) -> list[Collision]:
        """All pairs of a link of this arm and another body that are nearer than the clearance of the scene. The link is
        first; what the arm holds is left out."""
        self._set(joints, scene)
        mine = self._table.matching(arm) & self._table.arm_piece
        others = self._table.carriers(scene) != self._table.number[arm]
        wanted = self._table.between(mine, others)
        hits = [self._describe(n) for n in self._hits() if wanted[n]]
        return [
            hit if hit.body_a.split()[0] == arm else replace(hit, body_a=hit.body_b, body_b=hit.body_a) for hit in hits
        ]

    def too_near(self, joints: Mapping[str, Floats], scene: Scene) -> list[Collision]:
        """All pairs that are nearer than their clearance in the scene."""
        self._set(joints, scene)
        if not self._touches_any():
            return []
        return [self._describe(pair) for pair in self._hits()]

    def least_room(
        self, arm: str, configurations: Array, others: Mapping[str, Floats], scene: Scene, hit: PathCollision
    ) -> PathCollision:
        """Where along a path, from a hit on, its two bodies are nearest to each other, or deepest in one another.

        Every `STRIDE`-th configuration is measured, and those around the nearest of them.
        """
        self._set({**others, arm: configurations[0]}, scene)
        table, slots = self._table, self._bodies.arms[arm].joints
        bodies_of = (table.matching(name) for name in (hit.collision.body_a, hit.collision.body_b))
        pairs = np.flatnonzero(table.between(*bodies_of) & self._pairs.active).tolist()
        found: dict[int, Collision] = {}

        def measure(rows: Iterable[int]) -> int:
            for n in rows:
                if n not in found:
                    self._q[slots] = configurations[n]
                    if scene.hung:
                        self._turn_hung(scene)
                    self._place()
                    found[n] = min(map(self._describe, pairs), key=lambda one: one.distance_m)
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
        self._set({**others, arm: configurations[0]}, scene)
        slots, rows = self._bodies.arms[arm].joints, np.asarray(configurations, dtype=float)
        for index in range(len(rows)):
            self._q[slots] = rows[index]
            self._turn_hung(scene)
            if hit := self._ask():
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
        hung = self._table.touches(scene.hung)
        found = self._first_too_near(slots, step, [pair for pair in near if not hung[pair]], off)
        if found is not None:
            self._put(slots, step, found[0])
            return self._describe(found[1])
        for n in range(1, TURNING_STEPS):
            self._put(slots, step, n / TURNING_STEPS)
            if hit := self._ask():
                return hit
        return None

    def _turn_hung(self, scene: Scene) -> None:
        """Turns the hung objects of a scene to the hands that hold them at the present configuration."""
        pin.forwardKinematics(self._bodies.model, self._data, self._q)
        for name, hung in scene.hung.items():
            hand = self._bodies.arms[hung.arm]
            tcp = (self._data.oMi[hand.hand_joint] * hand.tcp).translation
            self._placed.pop(name, None)  # elsewhere than in the scene
            self._place_body(name, "", hinges.at_hand(hung.home, hung.axis, hung.range_rad, hung.point, tcp))

    def _at(self, slots: list[int], rows: Array, index: int, leaving: dict[int, float]) -> Collision | None:
        """What is wrong with one configuration of a path and with the way to it; `leaving` is brought up to date."""
        self._q[slots] = rows[index]
        hit = self._ask()
        while hit is not None and self._touched_at(slots, rows[0], self._hit, hit, leaving):
            self._q[slots] = rows[index]
            hit = self._ask()
        return hit or self._left(slots, rows[index - 1], rows[index], leaving)

    def _parts(self, slots: list[int], rows: Array, group: int, off: Array = STRAIGHT) -> Parts:
        """Finds the parts of the way along these configurations on which a pair may be too near.

        The function returns the next part behind the configuration before this index; what is before the part is free.
        `group`: steps that one check of coal may prove free.
        """
        if self._boxes is None:
            return self._coal_parts(slots, rows, group, off)
        boxes = self._boxes

        def part(index: int) -> Part:
            free, near = boxes.way(self._q, slots, rows, index - 1, off)
            return (free, free + 2, near) if near else (free, free + 1, near)

        return part

    def _coal_parts(self, slots: list[int], rows: Array, group: int, off: Array) -> Parts:
        """As `_parts`, without boxes. Groups of neighbouring configurations are checked at once in their middle, with a
        margin as wide as any pair can come nearer within the group (`rtc.model.robot.levers`)."""
        size, widened = group, 0

        def part(index: int) -> Part:
            nonlocal size, widened
            if index >= widened:
                size, widened = group, min(index + SECTION, len(rows))
                self._widen(slots, rows[index - 1 : widened], size, off[index - 1 : widened - 1])
            while True:
                last = min(index + size, widened)
                near = self._near_pairs(slots, rows[index - 1 : last])
                if len(near) <= FEW or size == 1:
                    return index - 1, last, near
                size = 1  # shorter groups, up to the end of this section
                self._widen(slots, rows[index - 1 : widened], size, off[index - 1 : widened - 1])

        return part

    def _near_pairs(self, slots: list[int], rows: Array) -> list[int]:
        """The pairs that may be too near on the way along these configurations."""
        self._q[slots] = 0.5 * (rows[(len(rows) - 1) // 2] + rows[len(rows) // 2])
        return self._wider.pairs_within(self._data, self._q)

    def _first_too_near(
        self, slots: list[int], rows: Array, pairs: list[int], off: Array = STRAIGHT
    ) -> tuple[float, int] | None:
        """Where on the way along these configurations a pair may be nearer than its margin: (number of the
        configuration, with a fraction between two; pair)."""
        levers = self._levers_of_pairs(slots)[pairs]
        steps = levers @ np.abs(rows[1:] - rows[:-1]).T
        reach = np.hstack((np.zeros((len(pairs), 1)), np.cumsum(steps, axis=1))).tolist()
        nearer = levers @ off.max(axis=0) if len(off) else np.zeros(len(pairs))
        least = np.maximum(self._pairs.margin[pairs], 0.0) + nearer
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
        self._q[slots] = rows[-1]
        self._place()
        return any(self._distance_m(pair) < max(float(self._pairs.margin[pair]), 0.0) for pair in pairs)

    def _where_too_near(
        self, slots: list[int], rows: Array, pair: int, reach: list[float], margin: float, last: float
    ) -> float | None:
        """`_first_too_near` of one pair, as far as the place `last`. `reach`: how much nearer it can be at each
        configuration than at the first.

        What its distance exceeds its margin by is free on the way, as far as the pair can come nearer by that. A single
        step at whose end the pair is too near is halved: a slow approach would take a hundred such measurements."""

        def room_at(place: float) -> float:
            self._put(slots, rows, place)
            return self._distance_m(pair) - margin

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
        self._q[slots] = rows[n] + (place - n) * (rows[n + 1] - rows[n])
        if self._scene is not None and self._scene.hung:
            self._turn_hung(self._scene)
        self._place()

    def _distance_m(self, pair: int) -> float:
        return float(pin.computeDistance(self._bodies.geometry, self._geometry_data, pair).min_distance)

    def _touches_any(self) -> bool:
        """Whether a pair is too near at the present configuration; it is `_hit` then."""
        bodies, data = self._bodies, self._geometry_data
        if self._boxes is None:
            self._tell_coal()
            touches = bool(pin.computeCollisions(bodies.model, self._data, self._manager, self._callback, self._q))
            self._hit = self._callback.collisionPairIndex
            return touches
        near = [pair for pair in self._boxes.undecided(self._q, self._varying) if pair not in self._left_out]
        if near:
            self._place()
        for pair in near:
            if pin.computeCollision(bodies.geometry, data, pair):
                self._hit = pair
                return True
        return False

    def _leave_out(self, pair: int) -> None:
        """Let no check find this pair, until it is counted again."""
        self._left_out.add(pair)
        self._geometry_data.deactivateCollisionPair(pair)

    def _count_again(self, pair: int) -> None:
        self._left_out.discard(pair)
        self._geometry_data.activateCollisionPair(pair)

    def _ask(self) -> Collision | None:
        return self._describe(self._hit) if self._touches_any() else None

    def _widen(self, slots: list[int], configurations: Array, group: int, off: Array) -> None:
        """Sets the wider margins: by as much as each pair can come nearer within half a group of this many steps."""
        steps = 0.5 * group * np.abs(configurations[1:] - configurations[:-1]).max(axis=0, initial=0.0)
        nearer = self._levers_of_pairs(slots) @ (steps + off.max(axis=0) if len(off) else steps)
        self._wider.put_in_force(self._pairs, self._table.as_matrix(self._pairs.margin + nearer + WIDER_M))

    def _levers_of_pairs(self, slots: list[int]) -> Array:
        """The levers of an arm's joints on the distance of each pair, [pairs][joints]."""
        known = self._pair_levers.get(slots[0])
        if known is None:
            levers = self._levers[:, slots]
            known = self._pair_levers[slots[0]] = of_pairs(levers[self._table.first], levers[self._table.second])
        return known

    def _let_leave(self) -> dict[int, float]:
        """The pairs that are too near at the present configuration, with distances (m); `_ask` skips them."""
        leaving = {n: self._distance_m(n) for n in self._hits()}
        for pair in leaving:
            self._leave_out(pair)
        return leaving

    def _hits(self) -> list[int]:
        """All pairs that are too near at the present configuration."""
        data = self._geometry_data
        if self._boxes is not None:
            self._place()
            near = self._boxes.undecided(self._q, self._varying)
            return [n for n in near if pin.computeCollision(self._bodies.geometry, data, n)]
        self._tell_coal()
        pin.computeCollisions(self._bodies.model, self._data, self._bodies.geometry, data, self._q, False)
        active = np.flatnonzero(self._pairs.active).tolist()
        return [n for n in active if data.collisionResults[n].isCollision()]

    def _touched_at(
        self, slots: list[int], start: Floats, pair: int, hit: Collision, leaving: dict[int, float]
    ) -> bool:
        """True if the pair of a hit was in contact at the start too; it may separate then.

        coal misses some pairs of boxes with coplanar faces, and finds them one millimetre later.
        """
        self._q[slots] = start
        self._place()
        start_m = self._distance_m(pair)
        if start_m > max(float(self._pairs.margin[pair]), 0.0) or hit.distance_m < start_m - DEEPER_M:
            return False
        leaving[pair] = hit.distance_m
        self._leave_out(pair)
        return True

    def _place(self) -> None:
        """Moves all pieces to the present configuration."""
        self._tell_coal()
        bodies, data = self._bodies, self._geometry_data
        pin.updateGeometryPlacements(bodies.model, self._data, bodies.geometry, data, self._q)

    def _left(self, slots: list[int], before: Floats, after: Floats, leaving: dict[int, float]) -> Collision | None:
        """`_nearer_again` between two configurations, in steps that are too small to pass through a thin bar."""
        way, together = np.asarray(after, dtype=float) - np.asarray(before, dtype=float), len(leaving)
        for n in range(1, LEAVING_STEPS + 1):
            self._q[slots] = before + n / LEAVING_STEPS * way
            self._place()
            hit = self._nearer_again(leaving)
            if hit is not None:
                return hit
        return self._ask() if len(leaving) < together else None

    def _nearer_again(self, leaving: dict[int, float]) -> Collision | None:
        """The first of these pairs whose distance has decreased; separated pairs return to the normal check."""
        for pair, greatest_m in list(leaving.items()):
            distance_m = self._distance_m(pair)
            if distance_m < greatest_m - DEEPER_M:
                return self._describe(pair)
            leaving[pair] = max(greatest_m, distance_m)
            if distance_m > max(float(self._pairs.margin[pair]), 0.0) + DEEPER_M:
                del leaving[pair]
                self._count_again(pair)
        return None

    def _describe(self, pair: int) -> Collision:
        i, j = self._bodies.pairs[pair]
        result = coal.DistanceResult()
        a, b = (self._bodies.geometry.geometryObjects[n].geometry for n in (i, j))
        placements = (self._geometry_data.oMg[n] for n in (i, j))
        at, bt = (coal.Transform3s(one.rotation, one.translation) for one in placements)
        distance = coal.distance(a, at, b, bt, coal.DistanceRequest(), result)
        middle = 0.5 * (np.asarray(result.getNearestPoint1()) + np.asarray(result.getNearestPoint2()))
        x, y, z = (float(n) for n in middle)
        first, second = self._bodies.pieces[i], self._bodies.pieces[j]
        if first.kind == "movable" and second.kind in ("arm", "base"):
            first, second = second, first
        return Collision(first.label, second.label, float(distance), (x, y, z), float(self._pairs.margin[pair]))

    def _set(self, joints: Mapping[str, Floats], scene: Scene) -> None:
        if scene is not self._scene:
            self._arrange(scene)
        for name, place in self._places.items():
            if name not in joints:
                raise ValueError(f"joints of {name} are missing: a check needs those of every arm")
            self._q[place] = joints[name]

    def _arrange(self, scene: Scene) -> None:
        """Applies a scene: poses, parents and openings; then active pairs and margins."""
        before, self._scene = self._scene, None  # None until done: after an error the scene is applied in part only
        # Scenes often differ only in active pairs and margins; then no body has to be placed again.
        if before is None or not same_places(before, scene):
            self._place_bodies(scene)
        self._switch(scene)
        self._scene = scene

    def _place_bodies(self, scene: Scene) -> None:
        """Sets the openings, and the poses and parents of the bodies that are elsewhere than in the scene before."""
        for name, slots in self._bodies.arms.items():
            opening = scene.openings_m.get(name, self.cell.arm(name).gripper.max_opening_m)
            self._q[slots.fingers] = 0.5 * opening
        for owner, built in self._built_pose.items():
            held = scene.held.get(owner)
            pose = scene.poses.get(owner, built) if held is None else held.pose
            wanted = ("" if held is None else held.arm, pose if pose is built else np.asarray(pose).tolist())
            if self._placed.get(owner) != wanted:
                self._placed.pop(owner, None)
                self._place_body(owner, *wanted)
                self._placed[owner] = wanted

    def _place_body(self, owner: str, holder: str, pose: Floats) -> None:
        """Places the pieces of a body: in the world, or in the hand of an arm."""
        parent, at = 0, bodies.se3(pose)
        if holder:
            hand = self._bodies.arms[holder]
            parent, at = hand.hand_joint, hand.tcp * at
        pieces = self._table.pieces_of.get(owner, [])
        if not pieces:
            return
        if parent or self._levers[pieces[0]].any():  # all of them have the same
            self._levers[pieces] = levers(self._bodies.model, parent, at.translation, self._radius_m.get(owner, 0.0))
            self._pair_levers.clear()
        self._elsewhere[owner] = parent, at
        if self._boxes is not None:
            self._boxes.place(pieces, parent, at)

    def _switch(self, scene: Scene) -> None:
        """Sets the active pairs and the margins of a scene."""
        arms = [scene.moving] if scene.moving else list(self._bodies.arms)
        self._varying = [slot for name in arms for slot in self._bodies.arms[name].joints]
        held = in_hands(scene)
        unsure, close = tuple(scene.pose_tolerance_m.items()), tuple(scene.close.items())
        lists = map(tuple, (scene.ignore, scene.near, scene.keep_out))
        rules = (scene.moving, held, unsure, close, *lists, scene.clearance_m, scene.arms_apart_m)
        pairs = self._pairs_of_scene.get(rules)
        if pairs is None:
            if len(self._pairs_of_scene) >= KEPT_SCENES:
                del self._pairs_of_scene[next(iter(self._pairs_of_scene))]
            pairs = self._pairs_of_scene[rules] = self._table.of_scene(scene)
        if pairs is not self._pairs:
            self._put_in_force(pairs)

    def _put_in_force(self, pairs: Pairs) -> None:
        if self._boxes is not None:
            self._boxes.use(pairs.numbers, pairs.kept)
        self._pairs = pairs

    def _tell_coal(self) -> None:
        """Brings coal up to the scene. Where boxes decide a whole job it is never needed."""
        for owner, (parent, at) in self._elsewhere.items():
            items, pieces = self._bodies.geometry.geometryObjects, self._bodies.pieces
            for n in self._table.pieces_of.get(owner, ()):
                items[n].parentJoint, items[n].placement = parent, at * pieces[n].in_owner
        self._elsewhere.clear()
        pairs, before = self._pairs, self._pairs_of_coal
        if pairs is before:
            return
        # Set as matrices: a loop over 1700 pairs would take 5 ms.
        if before is None or not np.array_equal(before.active, pairs.active):
            self._geometry_data.setActiveCollisionPairs(self._bodies.geometry, pairs.active_matrix)
        self._geometry_data.setSecurityMargins(self._bodies.geometry, pairs.margin_matrix)
        self._pairs_of_coal = pairs

    def _measure_bodies(self) -> None:
        """Sets the levers, sizes and built poses of all bodies."""
        pieces = self._bodies.pieces
        items = self._bodies.geometry.geometryObjects
        balls = [ball(item.geometry, piece.in_owner) for item, piece in zip(items, pieces, strict=True)]
        joints = [item.parentJoint for item in items]
        self._levers = np.array(
            [levers(self._bodies.model, joint, *around) for joint, around in zip(joints, balls, strict=True)]
        )
        #: radius of a ball around the origin of each owner, for a body that is held
        self._radius_m = {
            owner: max(math.hypot(*balls[n][0]) + balls[n][1] for n in numbers)
            for owner, numbers in self._table.pieces_of.items()
        }
        self._built_pose = {seat.name: np.asarray(seat.frame.pose).tolist() for seat in self.cell.seats}
        self._built_pose |= {n.name: np.asarray(self.cell.object_pose(n.name)).tolist() for n in self.cell.objects}
        self._built_pose |= {region.name: np.asarray(region.frame.pose).tolist() for region in self.cell.regions}


def line(start: Array, end: Array, steps: int) -> Array:
    """A line in joint space in equal steps, [steps + 1][joints]."""
    rows: Array = start + (np.arange(steps + 1) / steps)[:, None] * (end - start)
    return rows


@cache
def _halfway(count: int) -> list[int]:
    """At most `PROBES` numbers below `count`: the middle, the middles of both halves, and so on."""
    places = (odd * count // parts for parts in (2, 4, 8) for odd in range(1, parts, 2))
    return list(dict.fromkeys(places))[:PROBES]

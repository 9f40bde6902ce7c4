"""What exact arms are near to, and whether two of them touch, by the collision model of the planners.

Two arms are checked when they may have come near enough. Each check proves a distance, and each motion of either arm
uses up some of it. Bodies near an arm are looked for only while a primitive watches its clearance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import combinations

import numpy as np

from rtc.model.cells import cell as cells
from rtc.model.robot.collision import CollisionWorld
from rtc.model.robot.collision_scene import Held, Scene
from rtc.spatial.geometry import Array
from rtc.subsystems.motion.arm import Near

PROVEN_M = (0.2, 0.05, 0.01, 0.002)  # distances that a check tries to prove, the greatest first


class _Pair:
    """Two arms: their joint values (rad) at the latest look, and what is left of the proven distance (m)."""

    def __init__(self, arm: str, other: str) -> None:
        self.names = (arm, other)
        self.left_m = 0.0
        self.joints: list[Sequence[float]] = []
        self.reaches: list[list[float]] = []  # how far each joint moves any point of its arm at most (m per rad)
        self.touch = False

    def move_to(self, now: list[Sequence[float]]) -> bool:
        """Uses up what the motion since the latest look may have brought the arms nearer; whether any has moved."""
        moved = False
        for reach, before, after in zip(self.reaches, self.joints, now, strict=True):
            if after is not before:
                moved = True
                self.left_m -= sum([m * abs(a - b) for m, a, b in zip(reach, after, before, strict=True)])
        self.joints = now
        return moved


class Watch:
    """The bodies of one cell. `poses`: of objects and seats (world); `carried`: object -> (arm, pose in tcp axes). Both
    belong to the simulation, which changes them."""

    def __init__(self, cell: cells.Cell, poses: Mapping[str, Array], carried: Mapping[str, tuple[str, Array]]) -> None:
        self._cell, self._poses, self._carried = cell, poses, carried
        self._pairs = [_Pair(a.name, b.name) for a, b in combinations(cell.arms, 2)]
        self._held: tuple[tuple[str, str], ...] = ()

    @cached_property
    def _world(self) -> CollisionWorld:
        return _world_of(self._cell)

    def use(self, cell: cells.Cell) -> None:
        """The cell with its arms as they are from now on: another hand is another model."""
        self._cell = cell
        self.__dict__.pop("_world", None)
        for pair in self._pairs:
            pair.joints = []

    def prepare(self) -> None:
        """Build what the first motion would otherwise wait for."""
        assert self._world is not None

    def touching(self, arm: str, joints: Mapping[str, Sequence[float]]) -> list[str]:
        """The arms that this arm touches, with what they hold. `joints`: rad, of all arms."""
        if (held := tuple((name, by) for name, (by, _) in self._carried.items())) != self._held:
            self._held = held
            for pair in self._pairs:
                pair.joints = []
        found = []
        for pair in self._pairs:
            if arm in pair.names:
                self._look(pair, joints)
                if pair.touch:
                    found.append(pair.names[1] if pair.names[0] == arm else pair.names[0])
        return found

    def near(self, arm: str, within_m: float, joints: Mapping[str, Sequence[float]]) -> Sequence[Near]:
        """Bodies and other arms nearer than a distance to this arm, or to what it holds."""
        found = self._world.near(arm, joints, self._scene(arm, within_m))
        return [Near(n.distance_m, n.point.tolist(), n.link, n.body, n.away, n.joints) for n in found if n.joints[1]]

    def _look(self, pair: _Pair, joints: Mapping[str, Sequence[float]]) -> None:
        now = [joints[name] for name in pair.names]
        if pair.joints and not pair.move_to(now):
            return
        if not pair.joints or pair.left_m <= 0.0:
            pair.joints = now
            self._check(pair, *map(np.asarray, now))

    def _check(self, pair: _Pair, mine: Array, theirs: Array) -> None:
        check = self._world.compare_arms(*pair.names, self._scene(pair.names[0], 0.0))
        pair.reaches = [reach.tolist() for reach in check.reaches]
        still = np.zeros(len(mine)), np.zeros(len(theirs))

        def apart(clearance_m: float) -> bool:
            return check.apart(mine, still[0], theirs, still[1], clearance_m)

        pair.left_m = next((clearance_m for clearance_m in PROVEN_M if apart(clearance_m)), 0.0)
        pair.touch = pair.left_m == 0.0 and not apart(0.0)

    def _scene(self, arm: str, clearance_m: float) -> Scene:
        hinged = {thing.name for thing in self._cell.objects if thing.hinge is not None}
        held = {n: Held(by, grasp) for n, (by, grasp) in self._carried.items() if n not in hinged}
        known = {*(thing.name for thing in self._cell.objects), *(seat.name for seat in self._cell.seats)}
        poses = {name: pose for name, pose in self._poses.items() if name in known and name not in held}
        return Scene(poses=poses, held=held, clearance_m=clearance_m, moving=arm)


_BUILT: dict[str, CollisionWorld] = {}  # by the digest of the cell: building one takes 40 ms


def _world_of(cell: cells.Cell) -> CollisionWorld:
    digest = cell.digest()
    if digest not in _BUILT:
        _BUILT.clear()
        _BUILT[digest] = CollisionWorld(cell)
    return _BUILT[digest]

"""Whether two arms stay apart while both move: one check for many pairs of postures. Pure.

One check in the middle of two intervals of motion can prove that no posture of one meets any posture of the other. It
does if the two arms are farther apart there than both can move within their intervals (`rtc.model.robot.levers`). The
timing of the two arms does not matter. The check has a collision model of the two arms alone, which is four times
faster than that of the whole cell.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from rtc.model.robot.bodies import Bodies
from rtc.model.robot.swept import Chain, Swept
from rtc.spatial.geometry import Array

KEPT = 8  # maximum number of collision models that are kept


class _Pair(NamedTuple):
    """The collision model of two arms and what they hold. Indices are those of its own pieces."""

    first: np.ndarray
    second: np.ndarray
    geometry: pin.GeometryModel
    data: pin.GeometryData
    manager: pin.BroadPhaseManager_NaiveCollisionManager
    callback: pin.CollisionCallBackDefault
    margins: Array  # [pieces][pieces], m


class SeparationCheck:
    """Checks of the distance between two arms, each with what it holds. Not thread-safe: it keeps what it compares."""

    def __init__(self, bodies: Bodies) -> None:
        self._bodies = bodies
        self._data = bodies.model.createData()
        self._q = pin.neutral(bodies.model)
        self._kept: dict[tuple[tuple[int, ...], tuple[int, ...]], _Pair] = {}  # by the pieces of both
        self._chains: dict[str, Chain] = {}
        self._empty_handed: dict[str, Swept] = {}
        self._pair: _Pair
        self._slots: tuple[list[int], list[int]] = ([], [])
        self._levers: tuple[Array, Array] = (np.zeros((0, 0)), np.zeros((0, 0)))
        self.swept: tuple[Swept, Swept]  # the pieces of the two arms

    def compare(
        self, arm: str, other: str, carried: tuple[np.ndarray, np.ndarray], levers: Array, openings_m: dict[str, float]
    ) -> None:
        """Prepare checks of `arm` against `other`.

        `carried`: masks of the pieces of each, held objects included. `levers`: [pieces][values of the
        configuration]. `openings_m`: of the hands, by arm; the same in all calls.
        """
        mine, theirs = (np.flatnonzero(mask).tolist() for mask in carried)
        for name, slots in self._bodies.arms.items():
            self._q[slots.fingers] = 0.5 * openings_m[name]
        self._pair = pair = self._pair_of(mine, theirs)
        self._slots = (self._bodies.arms[arm].joints, self._bodies.arms[other].joints)
        own = levers[mine + theirs]
        both = own[pair.first] + own[pair.second]  # a joint moves the pieces of one arm only
        self._levers = (both[:, self._slots[0]], both[:, self._slots[1]])
        self.swept = (self._swept(arm, mine, levers), self._swept(other, theirs, levers))

    def _pair_of(self, mine: list[int], theirs: list[int]) -> _Pair:
        """The collision model of these pieces, with those of held objects where they are now."""
        known = tuple(mine), tuple(theirs)
        if known not in self._kept:
            if len(self._kept) >= KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[known] = self._made(mine, theirs)
        pair = self._kept[known]
        for at, n in enumerate(mine + theirs):
            if self._bodies.pieces[n].kind == "movable":
                solid = self._bodies.geometry.geometryObjects[n]
                copy = pair.geometry.geometryObjects[at]
                copy.parentJoint, copy.placement = solid.parentJoint, solid.placement
        return pair

    def _made(self, mine: list[int], theirs: list[int]) -> _Pair:
        solids, wanted = self._bodies.geometry.geometryObjects, {frozenset(pair) for pair in self._bodies.pairs}
        geometry = pin.GeometryModel()
        for n in mine + theirs:
            geometry.addGeometryObject(solids[n])
        for a, n in enumerate(mine):
            for b, other in enumerate(theirs, len(mine)):
                if frozenset((n, other)) in wanted:
                    geometry.addCollisionPair(pin.CollisionPair(a, b))
        pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
        first, second = np.array(pairs, dtype=int).reshape(-1, 2).T
        data = geometry.createData()
        manager = pin.BroadPhaseManager_NaiveCollisionManager(self._bodies.model, geometry, data)
        callback = pin.CollisionCallBackDefault(geometry, data, True)
        count = len(geometry.geometryObjects)
        return _Pair(first, second, geometry, data, manager, callback, np.zeros((count, count)))

    def _swept(self, arm: str, pieces: list[int], levers: Array) -> Swept:
        """The pieces of an arm with what it holds; those of an empty-handed arm never change."""
        empty_handed = all(self._bodies.pieces[n].owner == arm for n in pieces)
        if empty_handed and arm in self._empty_handed:
            return self._empty_handed[arm]
        joints = self._bodies.arms[arm].joints
        if arm not in self._chains:
            self._chains[arm] = Chain(self._bodies.model, joints, self._q)
        solids = [self._bodies.geometry.geometryObjects[n] for n in pieces]
        swept = Swept(self._chains[arm], solids, levers[np.ix_(pieces, joints)])
        if empty_handed:
            self._empty_handed[arm] = swept
        return swept

    @property
    def reaches(self) -> tuple[Array, Array]:
        """Upper bounds of how far each joint of the two arms moves any point of its arm (m per rad)."""
        return self._levers[0].max(axis=0, initial=0.0), self._levers[1].max(axis=0, initial=0.0)

    def apart(self, mine: Array, turns: Array, theirs: Array, their_turns: Array, clearance_m: float) -> bool:
        """Whether the arms keep this clearance at all joint values that differ from these by at most the turns.

        Joints of the arm and of the other one, and how far each of them turns (rad)."""
        pair = self._pair
        near_m = self._levers[0] @ turns + self._levers[1] @ their_turns + clearance_m
        pair.margins[pair.first, pair.second] = near_m
        pair.data.setSecurityMargins(pair.geometry, pair.margins)
        self._q[self._slots[0]], self._q[self._slots[1]] = mine, theirs
        return not pin.computeCollisions(self._bodies.model, self._data, pair.manager, pair.callback, self._q)

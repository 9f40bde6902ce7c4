"""Whether two arms stay apart while both move: one check for many pairs of postures. Pure.

One check in the middle of two intervals of motion can prove that no posture of one meets any posture of the other. It
does if the two arms are farther apart there than both can move within their intervals (`rtc.model.robot.levers`). The
timing of the two arms does not matter.

Boxes around the bodies prove most of it (`rtc.model.robot.boxes`). coal has a collision model of the two arms alone,
which is four times faster than that of the whole cell.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

from rtc.model.robot.scene_state import SceneState
from rtc.spatial.geometry import Array

if TYPE_CHECKING:
    from rtc.model.robot._boxes import Separation

MAX_MODELS = 8  # maximum number of collision models that are kept


class Interval(NamedTuple):
    """From the posture `first` of a way to the posture `last`."""

    first: int
    last: int

    @property
    def length(self) -> int:
        return self.last - self.first


class _Model(NamedTuple):
    """coal's model of two arms and what they hold. Indices are those of its own pieces."""

    pieces: list[int]  # of the cell
    pairs: tuple[np.ndarray, np.ndarray]
    geometry: pin.GeometryModel
    data: pin.GeometryData
    manager: pin.BroadPhaseManager_NaiveCollisionManager
    callback: pin.CollisionCallBackDefault
    margins: Array  # [pieces][pieces], m


class SeparationCheck:
    """Checks of the distance between two arms, each with what it holds. Not thread-safe: it keeps what it compares."""

    def __init__(self, state: SceneState) -> None:
        self._state = state
        self._data = state.bodies.model.createData()
        self._q = pin.neutral(state.bodies.model)
        self._kept: dict[bytes, _Model] = {}  # by the pairs of pieces
        self._model: _Model | None = None  # made when it is first needed
        self._pairs: Array = np.zeros((0, 2), dtype=int)
        self._slots: tuple[list[int], list[int]] = ([], [])
        self._levers: tuple[Array, Array] = (np.zeros((0, 0)), np.zeros((0, 0)))

    def compare(self, arm: str, other: str, pairs: Array, openings_m: dict[str, float]) -> None:
        """Prepare checks of `arm` against `other` in the present scene, as long as no other scene is used.

        `pairs`: [pairs][2], a piece of `arm` or of what it holds, and one of the other. `openings_m`: of the hands, by
        arm.
        """
        arms, levers = self._state.bodies.arms, self._state.levers
        for name, slots in arms.items():
            self._q[slots.fingers] = 0.5 * openings_m[name]
        self._pairs, self._model = pairs, None
        self._slots = (arms[arm].joints, arms[other].joints)
        both = levers[pairs[:, 0]] + levers[pairs[:, 1]]  # a joint moves the pieces of one arm only
        self._levers = (both[:, self._slots[0]], both[:, self._slots[1]])

    @property
    def reaches(self) -> tuple[Array, Array]:
        """Upper bounds of how far each joint of the two arms moves any point of its arm (m per rad)."""
        return self._levers[0].max(axis=0, initial=0.0), self._levers[1].max(axis=0, initial=0.0)

    def ways(self, mine: Array, theirs: Array, clearance_m: float) -> TwoWays:
        """Two ways to compare part by part, [postures][joints] each (rad)."""
        boxes = self._state.boxes
        compiled = None
        if boxes is not None:
            compiled = boxes.separation(self._q, self._pairs, self._slots, (mine, theirs), clearance_m)
        return TwoWays(self, mine, theirs, clearance_m, compiled)

    def apart(self, mine: Array, turns: Array, theirs: Array, their_turns: Array, clearance_m: float) -> bool:
        """Whether coal finds that the arms keep this clearance at all joint values that differ from these by at most
        the turns.

        Joints of the arm and of the other one, and how far each of them turns (rad)."""
        if self._model is None:
            self._model = self._model_of_pairs()
        model = self._model
        model.margins[model.pairs] = self._levers[0] @ turns + self._levers[1] @ their_turns + clearance_m
        model.data.setSecurityMargins(model.geometry, model.margins)
        self._q[self._slots[0]], self._q[self._slots[1]] = mine, theirs
        return not pin.computeCollisions(self._state.bodies.model, self._data, model.manager, model.callback, self._q)

    def _model_of_pairs(self) -> _Model:
        """The model of the present pairs, with held objects where they are now."""
        self._state.tell_coal()
        known = self._pairs.tobytes()
        if known not in self._kept:
            if len(self._kept) >= MAX_MODELS:
                del self._kept[next(iter(self._kept))]
            self._kept[known] = self._made()
        model, bodies = self._kept[known], self._state.bodies
        for at, n in enumerate(model.pieces):
            if bodies.pieces[n].kind == "movable":
                solid, copy = bodies.geometry.geometryObjects[n], model.geometry.geometryObjects[at]
                copy.parentJoint, copy.placement = solid.parentJoint, solid.placement
        return model

    def _made(self) -> _Model:
        bodies = self._state.bodies
        pieces, index = np.unique(self._pairs, return_inverse=True)
        pairs = np.sort(index.reshape(-1, 2), axis=1)
        geometry = pin.GeometryModel()
        for n in pieces.tolist():
            geometry.addGeometryObject(bodies.geometry.geometryObjects[n])
        for a, b in pairs.tolist():
            geometry.addCollisionPair(pin.CollisionPair(a, b))
        data = geometry.createData()
        manager = pin.BroadPhaseManager_NaiveCollisionManager(bodies.model, geometry, data)
        callback = pin.CollisionCallBackDefault(geometry, data, True)
        margins = np.zeros((len(pieces), len(pieces)))
        return _Model(pieces.tolist(), (pairs[:, 0], pairs[:, 1]), geometry, data, manager, callback, margins)


class TwoWays:
    """Two ways of which parts are compared; `compiled`: the proof by boxes, where it is installed."""

    def __init__(
        self, check: SeparationCheck, mine: Array, theirs: Array, clearance_m: float, compiled: Separation | None
    ) -> None:
        self._check, self._ways, self._clearance_m, self._compiled = check, (mine, theirs), clearance_m, compiled

    def open(self, known: int, part: Interval, late: Interval) -> int:
        """Which pairs may come too near while I am in `part` of my way, and they in `late` of theirs: a number for
        `known` when smaller parts of these are compared; 0: nothing is known. Negative: none, the arms are apart.

        What boxes leave undecided between two neighbouring postures of both ways coal decides."""
        if self._compiled is not None:
            known = self._compiled.open(known, *part, *late)
            if known < 0 or part.length > 1 or late.length > 1:
                return known
        mine, theirs = (_middle(way, of) for way, of in zip(self._ways, (part, late), strict=True))
        return -1 if self._check.apart(*mine, *theirs, self._clearance_m) else known


def _middle(way: Array, part: Interval) -> tuple[Array, Array]:
    """A posture of the part, and how far its other postures turn away from it at most, by joint (rad)."""
    rows = way[part.first : part.last + 1]
    low, high = rows.min(axis=0), rows.max(axis=0)
    return 0.5 * (low + high), 0.5 * (high - low)

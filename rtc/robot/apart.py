"""Whether two arms stay apart while both move: one check for many pairs of postures. Pure.

A check in the middle of two intervals of motion proves that no posture of one meets any posture of the other, if the
two arms are farther apart there than both can move within their intervals (`rtc.robot.levers`). The timing of the two
arms does not matter.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from rtc.robot.bodies import Bodies
from rtc.robot.geometry import Array


class ApartCheck:
    """Checks of the distance between two arms, each with what it holds. Not thread-safe: it keeps what it compares."""

    def __init__(self, bodies: Bodies) -> None:
        self._bodies = bodies
        self._pairs = np.array(bodies.pairs, dtype=int).reshape(-1, 2)
        count = len(bodies.pieces)
        self._active = np.zeros((count, count), dtype=bool)
        self._margins = np.zeros((count, count))
        self._data = bodies.model.createData()
        self._geometry_data = bodies.geometry.createData()
        self._manager = pin.BroadPhaseManager_NaiveCollisionManager(bodies.model, bodies.geometry, self._geometry_data)
        self._callback = pin.CollisionCallBackDefault(bodies.geometry, self._geometry_data, True)
        self._q = pin.neutral(bodies.model)
        self._slots: tuple[list[int], list[int]] = ([], [])
        self._first = self._second = np.zeros(0, dtype=int)
        self._levers: tuple[Array, Array] = (np.zeros((0, 0)), np.zeros((0, 0)))

    def compare(self, arm: str, other: str, between: np.ndarray, levers: Array, openings_m: dict[str, float]) -> None:
        """Prepare checks of `arm` against `other`.

        `between`: mask of the pairs of their pieces, held objects included. `levers`: [pieces][values of the
        configuration]. `openings_m`: of the hands, by arm.
        """
        self._first, self._second = self._pairs[between].T
        active = np.zeros_like(self._active)
        active[self._first, self._second] = True
        if not np.array_equal(active, self._active):
            self._geometry_data.setActiveCollisionPairs(self._bodies.geometry, active)
            self._active = active
        for name, slots in self._bodies.arms.items():
            self._q[slots.fingers] = 0.5 * openings_m[name]
        self._slots = (self._bodies.arms[arm].joints, self._bodies.arms[other].joints)
        both = levers[self._first] + levers[self._second]  # a joint moves the pieces of one arm only
        self._levers = (both[:, self._slots[0]], both[:, self._slots[1]])

    @property
    def reaches(self) -> tuple[Array, Array]:
        """Upper bounds of how far each joint of the two arms moves any point of its arm (m per rad)."""
        return self._levers[0].max(axis=0, initial=0.0), self._levers[1].max(axis=0, initial=0.0)

    def apart(self, mine: Array, turns: Array, theirs: Array, their_turns: Array, clearance_m: float) -> bool:
        """Whether the arms keep this clearance at all joint values that differ from these by at most the turns.

        Joints of the arm and of the other one, and how far each of them turns (rad)."""
        near_m = self._levers[0] @ turns + self._levers[1] @ their_turns + clearance_m
        self._margins[self._first, self._second] = near_m
        self._geometry_data.setSecurityMargins(self._bodies.geometry, self._margins)
        self._q[self._slots[0]], self._q[self._slots[1]] = mine, theirs
        model = self._bodies.model
        return not pin.computeCollisions(model, self._data, self._manager, self._callback, self._q)

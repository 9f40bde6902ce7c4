"""Groups of neighbouring configurations of a path that one check of coal proves free.

Without the compiled boxes this finds the parts of a path where bodies may be too near (`rtc.model.robot.collision`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from rtc.model.robot.collision_pairs import CollisionPairs
from rtc.model.robot.scene_state import SceneState
from rtc.spatial.geometry import Array

#: configurations [first, last) of a path, and the pairs that may be too near on the way along them
Part = tuple[int, int, list[int]]
#: the next part behind the configuration before this index; what is before the part is free
Parts = Callable[[int], Part]

FEW = 5  # pairs that are followed along a group
SECTION = 120  # configurations of a path with the same wider margins
WIDER_M = 1e-4  # tolerance of distances in the check of a group


class CoalGroups:
    """A second set of margins for the pairs of a scene, as wide as a pair can come nearer within a group."""

    def __init__(self, state: SceneState) -> None:
        self._state = state
        made = state.bodies
        self._data = made.geometry.createData()
        self._manager = pin.BroadPhaseManager_NaiveCollisionManager(made.model, made.geometry, self._data)
        self._callback = pin.CollisionCallBackDefault(made.geometry, self._data, True)
        self._pairs: CollisionPairs | None = None  # those of the margins

    def parts(self, slots: list[int], rows: Array, group: int, off: Array) -> Parts:
        """Finds the parts of the way along these configurations on which a pair may be too near.

        `group`: steps that are checked at once, in their middle. `off`: as for `CollisionWorld.check_path`.
        """
        size, widened = group, 0

        def part(index: int) -> Part:
            nonlocal size, widened
            if index >= widened:
                size, widened = group, min(index + SECTION, len(rows))
                self.widen(slots, rows[index - 1 : widened], size, off[index - 1 : widened - 1])
            while True:
                last = min(index + size, widened)
                near = self._near_pairs(slots, rows[index - 1 : last])
                if len(near) <= FEW or size == 1:
                    return index - 1, last, near
                size = 1  # shorter groups, up to the end of this section
                self.widen(slots, rows[index - 1 : widened], size, off[index - 1 : widened - 1])

        return part

    def widen(self, slots: list[int], rows: Array, group: int, off: Array) -> None:
        """Sets the margins: by as much as each pair can come nearer within half a group of this many steps."""
        state = self._state
        steps = 0.5 * group * np.abs(rows[1:] - rows[:-1]).max(axis=0, initial=0.0)
        nearer = state.levers_of_pairs(slots) @ (steps + off.max(axis=0) if len(off) else steps)
        if state.pairs is not self._pairs:
            self._data.setActiveCollisionPairs(state.bodies.geometry, state.pairs.active_matrix)
            self._pairs = state.pairs
        margins = state.table.as_matrix(state.pairs.margin + nearer + WIDER_M)
        self._data.setSecurityMargins(state.bodies.geometry, margins)

    def touches_any(self) -> bool:
        """Whether any pair is nearer than its margin at the present joint values."""
        state = self._state
        return bool(pin.computeCollisions(state.bodies.model, state.data, self._manager, self._callback, state.q))

    def _near_pairs(self, slots: list[int], rows: Array) -> list[int]:
        """The pairs that may be too near on the way along these configurations."""
        self._state.q[slots] = 0.5 * (rows[(len(rows) - 1) // 2] + rows[len(rows) // 2])
        found: list[int] = []
        touch = self.touches_any()
        while touch:
            found.append(self._callback.collisionPairIndex)
            self._data.deactivateCollisionPair(found[-1])
            touch = pin.computeCollisions(self._manager, self._callback)
        for pair in found:
            self._data.activateCollisionPair(pair)
        return found

"""Spring catches of seats: they hold a seated module in zero gravity until an arm pulls it out.

A catch holds a module with at most the seat's `detent_n`. It releases a module that has moved by more than `BREAKS_M`,
and catches a module that rests in the seat. Catches act in seats only; a grip is contact friction alone. A seat with
bolts fastens its module while one of them is not turned out, with more force than an arm exerts.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import pybullet

from rtc.spatial import geometry
from sim_mcm.arms.bullet_world import PhysicsWorld

BREAKS_M = 0.004  # travel of the catch before it releases
CATCHES_M = 0.004  # maximum distance from the seated place at which a module is caught ...
CATCHES_RAD = 0.05
REST_M_S = 0.002  # ... if it is not faster than this
EVERY = 10  # steps between two checks
# A jammed seat wedges a module this near to its place, with more force than an arm exerts.
WEDGES_M, WEDGES_RAD, WEDGED_N = 0.04, 0.2, 1000.0
FASTENED_N = 1000.0  # by bolts


class Detents:
    def __init__(self, world: PhysicsWorld, fastened: Callable[[str], bool] = lambda seat: False) -> None:
        """`fastened`: whether bolts fasten what is in a seat."""
        self._world = world
        self._fastened = fastened
        self._bolted: dict[str, str] = {}  # caught object -> the seat whose bolts fasten it
        self._caught: dict[str, tuple[list[int], list[float]]] = {}  # object -> (constraints, where it was caught)
        self._wedged: dict[str, str] = {}  # caught object -> the jammed seat that wedges it
        self._jammed: set[str] = set()  # seats
        self._seats = [seat for seat in world.cell.seats if seat.detent_n > 0]
        self._with_bolts = [seat.name for seat in self._seats if seat.bolts]
        self._steps = 0
        self.look()

    def step(self) -> None:
        """Once per physics step."""
        self._steps += 1
        if self._steps % EVERY == 0:
            self.look()

    def look(self) -> None:
        """Release modules that were pulled away; catch modules that rest in a seat."""
        for name, (_, at) in list(self._caught.items()):
            if name not in self._wedged and math.dist(self._world.position(name), at) > BREAKS_M:
                self.let_go(name)
        for name in sorted(self._world.free - self._caught.keys()):
            if max(map(abs, self._world.velocity(name)[:3])) < REST_M_S:
                self._catch_in_seat(name)
        for seat in self._with_bolts:
            self._fasten(seat)
        for seat in sorted(self._jammed):
            self._wedge(seat)

    def jam(self, seat: str, jammed: bool) -> None:
        """Wedge modules in a seat from now on, or free them."""
        if jammed:
            self._jammed.add(seat)
        else:
            self._jammed.discard(seat)
            for name in [name for name, by in self._wedged.items() if by == seat]:
                self.let_go(name)
        self.look()

    def _fasten(self, seat: str) -> None:
        """Hold the module in a seat with the force of its bolts, or with that of its catch alone."""
        fastened = self._fastened(seat)
        for name in [name for name, by in self._bolted.items() if by == seat and not fastened]:
            self.let_go(name)
            self._catch_in_seat(name)
        if not fastened or seat in self._bolted.values():
            return
        for name in [name for name in self._caught if name not in self._wedged and self._is_in(name, seat)]:
            self.let_go(name)
            self._catch(name, self._world.pose(name), FASTENED_N)
            self._bolted[name] = seat

    def _is_in(self, name: str, seat: str) -> bool:
        """Whether an object is in the seated place of a seat."""
        pose = self._world.pose(name)
        place = geometry.compose(self._world.seats[seat].home, self._world.cell.seat(seat).module_frame.pose)
        return geometry.distance(pose, place) < CATCHES_M and geometry.angle(pose, place) < CATCHES_RAD

    def _wedge(self, seat: str) -> None:
        place = geometry.compose(self._world.seats[seat].home, self._world.cell.seat(seat).module_frame.pose)
        for name in sorted(self._world.free - self._wedged.keys()):
            pose = self._world.pose(name)
            if geometry.distance(pose, place) < WEDGES_M and geometry.angle(pose, place) < WEDGES_RAD:
                self.let_go(name)
                self._catch(name, pose, WEDGED_N)
                self._wedged[name] = seat

    def _catch_in_seat(self, name: str) -> None:
        """Catch the object if it is in the seated place of a seat."""
        for seat in self._seats:
            if self._is_in(name, seat.name):
                self._catch(name, self._world.pose(name), seat.detent_n, seat.detent_nm)
                return

    def let_go(self, name: str) -> None:
        self._wedged.pop(name, None)
        self._bolted.pop(name, None)
        if name in self._caught:
            for constraint in self._caught.pop(name)[0]:
                pybullet.removeConstraint(constraint, physicsClientId=self._world.client)

    def let_go_all(self) -> None:
        for name in list(self._caught):
            self.let_go(name)

    def _catch(self, name: str, pose: geometry.Array, force_n: float, torque_nm: float | None = None) -> None:
        """Hold an object where it is with at most this force, and its attitude with at most this torque; None: as many
        N.m as N. A fixed constraint has one limit for both: one that holds a point adds the rest of the force."""
        both = force_n if torque_nm is None else torque_nm
        held = [self._hold(name, pybullet.JOINT_FIXED, both)]
        if both < force_n:
            held.append(self._hold(name, pybullet.JOINT_POINT2POINT, force_n - both))
        self._caught[name] = (held, pose[:3].tolist())

    def _hold(self, name: str, kind: int, most: float) -> int:
        """A constraint that holds an object where it is."""
        body, client = self._world.objects[name].id, self._world.client
        position, quaternion = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
        constraint: int = pybullet.createConstraint(
            body,
            -1,
            -1,
            -1,
            kind,
            [0, 0, 0],
            parentFramePosition=[0, 0, 0],
            childFramePosition=position,
            childFrameOrientation=quaternion,
            physicsClientId=client,
        )
        pybullet.changeConstraint(constraint, maxForce=most, physicsClientId=client)
        return constraint

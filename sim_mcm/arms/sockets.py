"""The sockets of connectors with physics: what their contacts and their latch do to a plug (`contacts`)."""

from __future__ import annotations

import numpy as np
import pybullet

from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from sim_mcm.arms.bullet_world import PhysicsWorld
from sim_mcm.arms.contacts import ASIDE_M, Contacts, out_m


class ConnectorSockets:
    """All sockets of a cell with physics."""

    def __init__(self, world: PhysicsWorld) -> None:
        self._world = world
        self._sockets = [(seat, seat.mating, Contacts(seat.mating)) for seat in world.cell.seats if seat.mating]
        self._plugs = [(thing.name, thing.plug) for thing in world.cell.objects if thing.plug is not None]

    def forget(self) -> None:
        """After a restored state: contacts stick where the plugs are."""
        for *_, contacts in self._sockets:
            contacts.forget()

    def step(self) -> None:
        """Before each physics step: push the plugs."""
        for seat, mating, contacts in self._sockets:
            home = self._world.seats[seat.name].home
            place, out = geometry.compose(home, seat.module_frame.pose), geometry.rotate(home, seat.way_out)
            for name, connector in self._plugs:
                if connector == mating.connector:
                    self._push(name, contacts, place, out, mating.depth_m)

    def _push(self, name: str, contacts: Contacts, place: Array, out: Array, depth_m: float) -> None:
        off = np.asarray(self._world.position(name)) - place[:3]
        if off @ off > (depth_m + ASIDE_M) ** 2:
            return
        pose = self._world.pose(name)
        at_m = out_m(place, out, pose)
        force_n = contacts.push_n(name, at_m) if at_m is not None else 0.0
        if force_n:
            pybullet.applyExternalForce(
                self._world.objects[name].id,
                -1,
                (force_n * out).tolist(),
                pose[:3].tolist(),
                pybullet.WORLD_FRAME,
                physicsClientId=self._world.client,
            )

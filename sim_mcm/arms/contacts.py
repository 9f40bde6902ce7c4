"""What a plug feels in the socket of a connector, with physics and for exact arms: contacts that rub, and a latch.

Both act along the way out of the seat: the friction of the contacts against any motion, the latch against the way in.
What holds a mated plug is the catch of the seat (`detents`, `kinematic_seats`).
"""

from __future__ import annotations

import numpy as np

from rtc.model.cells import parts
from rtc.spatial import geometry
from rtc.spatial.geometry import Array

STIFF_N_M = 20_000.0  # of contacts that stick; with a plug of 0.3 kg the steps of 1 ms still follow it
ASIDE_M, TILTED_RAD = 0.01, 0.2  # of a plug that touches the contacts


class Contacts:
    """The contacts and the latch of one socket. They stick to a plug, and slip where their friction ends."""

    def __init__(self, mating: parts.Mating) -> None:
        self._mating = mating
        self._stuck: dict[str, float] = {}  # plug -> where the contacts stick to it, distance from the mated place (m)

    def forget(self) -> None:
        self._stuck.clear()

    def push_n(self, plug: str, out_m: float) -> float:
        """Force (N) along the way out on a plug that is `out_m` from its mated place. Once per step."""
        most_n = self._mating.rubs_n(out_m)
        if most_n <= 0.0:
            self._stuck.pop(plug, None)
            return self._mating.latches_n(out_m)
        stretched_m = self._stuck.setdefault(plug, out_m) - out_m
        rubs_n = min(max(STIFF_N_M * stretched_m, -most_n), most_n)
        self._stuck[plug] = out_m + rubs_n / STIFF_N_M
        return rubs_n + self._mating.latches_n(out_m)


def out_m(place: Array, out: Array, pose: Array) -> float | None:
    """How far a plug is from its mated place `place`, along the way out; None if it is not in the socket."""
    off = pose[:3] - place[:3]
    along_m = float(off @ out)
    aside_m = float(np.linalg.norm(off - along_m * out))
    return along_m if aside_m < ASIDE_M and geometry.angle(pose, place) < TILTED_RAD else None

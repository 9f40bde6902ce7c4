"""An arm that moves without a primitive: pushed, or by itself. It is braked, and stays where it comes to rest. Pure."""

from __future__ import annotations

import math

from rtc.protocol import messages as m
from rtc.subsystems.motion.observation import Observation
from rtc.subsystems.motion.setpoints import Setpoints

# An arm without a primitive has strayed if its joints are farther than this from where they came to rest (norm; rad,
# m). A new path must begin within the same distance of it.
STRAYED = 0.01


class StrayWatch:
    def __init__(self, seen: Observation, setpoints: Setpoints) -> None:
        self._seen, self._setpoints = seen, setpoints
        self.how = ""  # it has moved since its latest primitive; empty: it has not
        self._from: list[float] | None = None  # until it rests

    @property
    def stands(self) -> bool:
        """Whether the arm is where it came to rest."""
        return math.dist(self._seen.sample.joints, self._seen.stands_at) <= STRAYED

    def brake(self, name: str) -> list[m.Strayed]:
        """A report when the motion begins, another when the arm rests."""
        seen, arm = self._seen, self._seen.arm
        if self._from is None:
            self._from = seen.stands_at
            arm.brake(True)
        elif not seen.joints_rest():
            return []
        joint, off = seen.farthest(self._from)
        far = f"{1e3 * off:.0f} mm" if arm.traits.margins(1.0)[joint] < 1.0 else f"{math.degrees(off):.1f} deg"
        rests = seen.joints_rest()
        self.how = f"moved without a command, {arm.traits.joint_names[joint]} by {far}; braked, it " + (
            "rests" if rests else "moves"
        )
        if rests:
            self._from = None
            seen.stands_at = seen.sample.joints
            arm.follow(self._setpoints.stand_at(seen.sample.joints))
        return [m.Strayed(arms={name: self.how})]

    def release(self) -> None:
        """A primitive begins."""
        if self.how:
            self._seen.arm.brake(False)
        self.how, self._from = "", None

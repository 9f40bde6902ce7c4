"""Where hands are in the couplers of arms, and when a coupler reaches one. Pure; shared by physics and exact arms.

A coupler has a taper: within its reach it draws the hand to its place and locks it rigidly. The way of the hand there,
at most 3 mm, is not simulated.
"""

from __future__ import annotations

from collections.abc import Sequence

from rtc.model.cells import cell as cells
from rtc.model.cells import parts
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.spelling import unknown
from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats

REACH_M, REACH_RAD = 0.003, 0.035  # of a coupler, between its tcp and the coupling point of the hand


class Couplers:
    """Those of the arms of a cell. Joint values in rad, poses in the world frame."""

    def __init__(self, cell: cells.Cell) -> None:
        self._cell = cell
        self._arms = {hand.name: arm.name for arm in cell.arms for hand in arm.hands}
        self._points = {
            hand.name: cell.object(hand.name).grasp_point(hand.coupling) for arm in cell.arms for hand in arm.hands
        }
        self._without = {name: ArmModel.of(cell, name) for name in set(self._arms.values())}

    def place(self, hand: str, joints: Sequence[float]) -> Array:
        """Pose of a hand, as an object, in the coupler of its arm at these joint values."""
        return geometry.compose(self._tcp(hand, joints), geometry.inverse(self.point(hand).frame.pose))

    def point(self, hand: str) -> parts.GraspPoint:
        """Where the jaws of the coupler take a hand."""
        return self._points[hand]

    def why_not(self, arm: str, hand: str, at: Floats, joints: Sequence[float]) -> str:
        """Why the coupler does not lock the hand that lies at this pose; empty: it does."""
        if self._arms.get(hand) != arm:
            return unknown(f"hand for the coupler of {arm}", hand, [one for one, of in self._arms.items() if of == arm])
        there, tcp = geometry.compose(at, self.point(hand).frame.pose), self._tcp(hand, joints)
        off_m, turned_rad = geometry.distance(there, tcp), geometry.angle(there, tcp)
        if off_m <= REACH_M and turned_rad <= REACH_RAD:
            return ""
        return f"the coupler of {arm} has locked nothing: no hand is within its reach"

    def _tcp(self, hand: str, joints: Sequence[float]) -> Array:
        """Of its arm without a hand."""
        return self._without[self._arms[hand]].fk(joints)

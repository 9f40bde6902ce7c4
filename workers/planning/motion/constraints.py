"""Path constraints of a hand (MAINTAIN): a work range that contains it and an attitude that it keeps.

Keep-out regions and clearances concern bodies; they belong to the collision `Scene`.
"""

from __future__ import annotations

import math

import msgspec

from rtc.model.cells import parts
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats

ATTITUDE_RAD = math.radians(5.0)  # within which a hand keeps its attitude
BEGINS_RAD = 2.0 * ATTITUDE_RAD  # a hand that begins farther off, but within this, comes no farther off
SLACK_RAD = 0.002


def attitude_tolerance_rad(start: Floats, attitude: parts.Frame) -> float:
    """How far off an attitude a hand may be on its way from the pose `start` (world)."""
    off_rad = geometry.angle(start, attitude.pose)
    return off_rad + SLACK_RAD if ATTITUDE_RAD < off_rad <= BEGINS_RAD else ATTITUDE_RAD


class PathConstraints(msgspec.Struct, frozen=True, eq=False):
    """Path constraints; None = not constrained."""

    work_range: parts.Region | None = None
    attitude: parts.Frame | None = None  # of the tcp, world frame
    attitude_name: str = ""
    attitude_tolerance_rad: float = ATTITUDE_RAD

    @property
    def any(self) -> bool:
        """Whether there is a constraint."""
        return self.work_range is not None or self.attitude is not None

    def violation(self, arm: ArmModel, joints: Array) -> Refusal | None:
        """The refusal for the first constraint that this posture (rad) violates; None if it violates none."""
        if not self.any:
            return None
        pose = arm.fk(joints)
        if self.work_range is not None and not self.work_range.contains(pose[:3]):
            return _refusal(
                f"the hand of {arm.name} would leave {self.work_range.name}",
                {"cause": "work_range", "region": self.work_range.name},
                pose,
            )
        if self.attitude is not None:
            off = geometry.angle(pose, self.attitude.pose)
            if off > self.attitude_tolerance_rad:
                name = self.attitude_name or "its attitude"
                return _refusal(
                    f"the hand of {arm.name} would be {math.degrees(off):.0f} deg off {name}",
                    {"cause": "attitude", "attitude": name, "off_rad": off, "limit_rad": self.attitude_tolerance_rad},
                    pose,
                )
        return None


FREE = PathConstraints()


def _refusal(message: str, detail: dict[str, float | str], pose: Array) -> Refusal:
    x, y, z = pose[:3].tolist()
    return Refusal(
        reason=RefusalReason.INFEASIBLE,
        message=message,
        clears="another way, or the command without that MAINTAIN",
        detail={**detail, "x_m": x, "y_m": y, "z_m": z},
    )

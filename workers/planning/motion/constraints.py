"""Path constraints of a hand (MAINTAIN): a work range that contains it and its load, and an attitude that it keeps.

Keep-out regions and clearances concern bodies; they belong to the collision `Scene`.
"""

from __future__ import annotations

import math
from functools import lru_cache

import msgspec

from rtc.model.cells import parts
from rtc.model.robot.kinematics import ArmModel
from rtc.protocol.advice import by_person
from rtc.protocol.causes import OffAttitude, OutsideWorkRange
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.spatial import geometry
from rtc.spatial.geometry import Array, Floats
from rtc.spatial.solid_boxes import Beside, Boxes

ATTITUDE_RAD = math.radians(5.0)  # within which a hand keeps its attitude
BEGINS_RAD = 2.0 * ATTITUDE_RAD  # a hand that begins farther off, but within this, comes no farther off
SLACK_RAD, SLACK_M = 0.002, 0.001


def attitude_tolerance_rad(start: Floats, attitude: parts.Frame) -> float:
    """How far off an attitude a hand may be on its way from the pose `start` (world)."""
    off_rad = geometry.angle(start, attitude.pose)
    return off_rad + SLACK_RAD if ATTITUDE_RAD < off_rad <= BEGINS_RAD else ATTITUDE_RAD


def loaded(within: PathConstraints, boxes: Boxes, start: Floats) -> PathConstraints:
    """The constraints with what the hand holds (boxes in tcp axes), which is at the pose `start` (world)."""
    region = within.work_range
    if region is None or not boxes:
        return within
    load = tuple(map(tuple, boxes))
    beyond_m = _beside(load, region).beyond_m(start)
    return msgspec.structs.replace(within, load=load, load_beyond_m=beyond_m + SLACK_M if beyond_m > 0.0 else 0.0)


class PathConstraints(msgspec.Struct, frozen=True, eq=False):
    """Path constraints; None = not constrained."""

    work_range: parts.Region | None = None
    attitude: parts.Frame | None = None  # of the tcp, world frame
    attitude_name: str = ""
    attitude_tolerance_rad: float = ATTITUDE_RAD
    load: tuple[tuple[float, ...], ...] = ()  # boxes round what the hand holds, as in `Beside`
    load_beyond_m: float = 0.0  # by which it may be outside: as far as it is at the start

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
            return _outside(f"the hand of {arm.name}", self.work_range, pose)
        if self._load_is_outside(pose):
            assert self.work_range is not None
            return _outside(f"what {arm.name} holds", self.work_range, pose)
        if self.attitude is not None:
            off = geometry.angle(pose, self.attitude.pose)
            if off > self.attitude_tolerance_rad:
                name = self.attitude_name or "its attitude"
                x, y, z = pose[:3].tolist()
                limit_rad = self.attitude_tolerance_rad
                cause = OffAttitude(attitude=name, off_rad=off, limit_rad=limit_rad, x_m=x, y_m=y, z_m=z)
                return _refusal(f"the hand of {arm.name} would be {math.degrees(off):.0f} deg off {name}", cause)
        return None

    def _load_is_outside(self, pose: Array) -> bool:
        if not self.load or self.work_range is None:
            return False
        return _beside(self.load, self.work_range).beyond_m(pose) > self.load_beyond_m


@lru_cache(maxsize=16)
def _beside(load: tuple[tuple[float, ...], ...], region: parts.Region) -> Beside:
    return Beside(load, region.frame.pose, region.size_m)


FREE = PathConstraints()


def _outside(what: str, region: parts.Region, pose: Array) -> Refusal:
    x, y, z = pose[:3].tolist()
    cause = OutsideWorkRange(region=region.name, x_m=x, y_m=y, z_m=z)
    return _refusal(f"{what} would leave {region.name}", cause)


def _refusal(message: str, cause: OutsideWorkRange | OffAttitude) -> Refusal:
    return Refusal(
        reason=RefusalReason.INFEASIBLE,
        message=message,
        clears=by_person("another way, or the command without that MAINTAIN"),
        cause=cause,
    )

"""Reports about one primitive (R in the paper; R65): plain functions from measurements to messages."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from rtc.protocol import messages as m
from rtc.protocol.outcomes import Reflex, StopReason
from rtc.spatial.geometry import Array
from rtc.subsystems.base.report_items import Measure, reading
from rtc.subsystems.motion.arm import Sample
from rtc.subsystems.motion.observation import Observation


class Trip(msgspec.Struct, frozen=True, kw_only=True):
    """Why a primitive ends: decided in one tick; the reason never changes afterwards."""

    reason: StopReason
    reflex: Reflex = Reflex.STOP
    back_off_m: float = 0.0
    measured: float | None = None
    limit: float | None = None
    message: str = ""
    at_path_s: float = 0.0  # time of the profile
    pose: list[float] | None = None  # of the tcp, in that tick
    wrench: list[float] | None = None


def end_report(
    primitive: str,
    performer: str,
    trip: Trip,
    *,
    at_s: float,
    duration_s: float,
    paused_s: float,
    moved_s: float,
    seen: Observation,
    items: Sequence[str] = (),
    measure: Measure,
    turned_rad: float | None = None,
) -> m.EndReport:
    sample = seen.sample
    return m.EndReport(
        primitive=primitive,
        performer=performer,
        reason=trip.reason,
        at_s=at_s,
        duration_s=duration_s,
        paused_s=paused_s,
        moved_s=moved_s,
        joints=sample.joints,
        slides=seen.slides,
        tcp_pose=seen.tcp().tolist(),
        wrench=seen.wrench,
        hand=seen.arm.traits.hand,
        hand_width_m=seen.width_m,
        hand_force_n=seen.grip_n,
        peak_force_n=seen.peak_force_n,
        peak_torque_nm=seen.peak_torque_nm,
        trip_pose=trip.pose,
        trip_wrench=trip.wrench,
        measured=trip.measured,
        limit=trip.limit,
        message=trip.message,
        reflex=trip.reflex,
        turned_rad=turned_rad,
        reading=reading(items, performer, seen, ended=True, measure=measure) if items else None,
    )


def not_begun(
    primitive: str,
    performer: str,
    why: str,
    *,
    at_s: float,
    reason: StopReason = StopReason.REFUSED,
    sample: Sample | None = None,
    tcp_pose: Array | None = None,
    hand: str | None = None,
) -> m.EndReport:
    """The end report of a primitive that was never started. Pass no sample if the performer does not exist."""
    return m.EndReport(
        primitive=primitive,
        performer=performer,
        reason=reason,
        at_s=at_s,
        duration_s=0.0,
        joints=sample.joints if sample else [],
        tcp_pose=tcp_pose.tolist() if tcp_pose is not None else [],
        wrench=sample.wrench if sample else [],
        hand=hand,
        hand_width_m=sum(sample.fingers) if sample else 0.0,
        hand_force_n=min(sample.finger_forces) if sample else 0.0,
        message=why,
    )

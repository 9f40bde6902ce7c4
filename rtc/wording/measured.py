"""Measurements and durations as text for people: centimetres, degrees, minutes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from rtc.protocol.outcomes import Measured, Sighting

MIN_S = 0.1  # smallest printed duration of a step
POLE_RAD = 1e-4  # nearer to straight up or down roll and yaw are ambiguous: the yaw is printed as 0


def duration(value_s: float) -> str:
    """A duration for people: 4.2 s, 46 min, 2 h 46 min; at least 0.1 s."""
    if value_s < MIN_S:
        return f"{MIN_S:g} s"
    if value_s < 60:
        return f"{value_s:.2g} s" if value_s < 10 else f"{value_s:.0f} s"
    minutes = round(value_s / 60)
    if minutes < 60:
        return f"{minutes} min"
    hours, left = divmod(minutes, 60)
    return f"{hours} h {left} min" if left else f"{hours} h"


def seconds(value: float) -> str:
    """A duration for people: 0.4 ms, 37 ms, 2.15 s."""
    if value < 0.01:
        return f"{value * 1e3:.2f} ms"
    return f"{value * 1e3:.0f} ms" if value < 1 else f"{value:.2f} s"


def in_words(measured: Measured) -> list[str]:
    """One line for each requested quantity."""
    lines = []
    if measured.tcp_pose is not None:
        lines.append(f"{measured.arm} pose: {_pose(measured.tcp_pose)}")
    if measured.wrench is not None:
        force, torque = measured.wrench[:3], measured.wrench[3:]
        peaks = ""
        if measured.peak_force_n is not None:
            of = " of both arms" if measured.partner else ""
            peaks = f"; peak{of} on the way {measured.peak_force_n:.1f} N, {measured.peak_torque_nm or 0.0:.2f} Nm"
        felt = f"forces: {_numbers(force, '.1f')} N, torques: {_numbers(torque, '.2f')} Nm (tool axes)"
        lines.append(f"{measured.arm} {felt}{peaks}")
    if measured.sighting is not None:
        lines += _sighting(measured.arm, measured.sighting)
    if measured.joints is not None:
        lines.append(f"{measured.arm} joints: {_joints(measured.joints, measured.slides)}")
    lines += [f"{measured.arm} {name.lower()}: {_other(value)}" for name, value in measured.others.items()]
    return lines + (in_words(measured.partner) if measured.partner else [])


def _joints(values: list[float], slides: list[int]) -> str:
    """-63.0 110.0 deg; with joints that slide each has its unit."""
    if not slides:
        return _numbers(map(math.degrees, values), ".1f") + " deg"
    return ", ".join(
        f"{1e3 * value:z.1f} mm" if n in slides else f"{math.degrees(value):z.1f} deg" for n, value in enumerate(values)
    )


def _sighting(camera: str, seen: Sighting) -> list[str]:
    metres, radians = (
        max(math.sqrt(max(0.0, seen.covariance[7 * n])) for n in axes) for axes in (range(3), range(3, 6))
    )
    doubt = ", ambiguous attitude" if seen.ambiguous else ""
    who = f"{' and '.join(seen.cameras)} see" if seen.cameras else f"{camera} sees"
    lines = [
        f"{who}: {_pose(seen.pose)}",
        f"  +- {1e3 * metres:.1f} mm, {math.degrees(radians):.2f} deg{doubt}; tags {', '.join(map(str, seen.tags))}, "
        f"{seen.error_px:.2f} px off, {1e3 * seen.age_s:.0f} ms old",
    ]
    if seen.velocity is not None:
        speed, rate = math.hypot(*seen.velocity[:3]), math.hypot(*seen.velocity[3:])
        lines.append(f"  moves with {1e3 * speed:.1f} mm/s and {math.degrees(rate):.2f} deg/s")
    return lines


def _other(value: object) -> str:
    """The value of an item that a package has added: a number, a text, a list or a map."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_other(part)}" for name, part in value.items())
    if isinstance(value, list):
        return " ".join(map(_other, value))
    return f"{value:.4g}" if isinstance(value, float) and abs(value) < 1e4 else str(value)


def _numbers(values: Iterable[float], form: str) -> str:
    return " ".join(format(value, "z" + form) for value in values)  # z: no minus before a zero


def _pose(pose: list[float]) -> str:
    x, y, z, *q = pose
    roll, pitch, yaw = (math.degrees(angle) for angle in _rpy(*q))
    place = f"x {100 * x:z.1f} y {100 * y:z.1f} z {100 * z:z.1f} cm"
    return f"{place}, roll {roll:z.1f} pitch {pitch:z.1f} yaw {yaw:z.1f} deg"


def _rpy(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """As `rtc.spatial.geometry.to_rpy`, but without numpy, whose import is slow."""
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    if abs(abs(pitch) - math.pi / 2) < POLE_RAD:
        return 0.0, pitch, math.copysign(2.0, -pitch) * math.atan2(x, w)
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw

"""The cell `swapout` with a coupler at the right arm, and two hands in racks beside it.

HAND-A is the hand of `swapout` in two parts. HAND-B opens wider, is longer and presses less.
"""

from __future__ import annotations

import re
from typing import Any

import msgspec

from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Arm, CoupledHand, Object, Seat

COUPLER_KG, JAW_KG, FINGER_KG = 0.1, 0.05, 0.1
OUT_M = 0.030  # from the sensor to the middle of the jaws of the coupler, where the stub of a hand is
LENGTH_M = 0.070  # from the sensor to the fingers of a hand

#: name -> width of the body, length of the fingers, tcp from the sensor (m), mass of the body (kg), opening (m), grip
#: force (N), payload (kg)
FIGURES = {"HAND-A": (0.11, 0.050, 0.105, 0.3, 0.08, 60, 2.5), "HAND-B": (0.13, 0.070, 0.120, 0.4, 0.10, 40, 1.8)}
PLACES = {"HAND-A": (-0.45, 1.05), "HAND-B": (-0.65, 1.05)}  # y, z of its rack
RACKS_M = 0.525  # x of the stubs in them


def _box(x: float, y: float, z: float, at: float, aside: float = 0.0) -> str:
    return (
        f'<collision><origin xyz="0 {aside} {at}"/>\n<geometry><box size="{x} {y} {z}"/></geometry></collision>\n'
        f'<visual><origin xyz="0 {aside} {at}"/>\n<geometry><box size="{x} {y} {z}"/></geometry></visual>\n'
    )


def _link(name: str, mass_kg: float, at: float, boxes: str, inertia: float, aside: float = 0.0) -> str:
    return (
        f'<link name="{name}">\n<inertial><origin xyz="0 {aside} {at}"/>\n<mass value="{mass_kg}"/>\n'
        f'<inertia ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"/></inertial>\n'
        f"{boxes}</link>\n"
    )


def _urdf(puma: str, palm: str, fingers_m: float, long_m: float, half_m: float, finger_kg: float, tcp_m: float) -> str:
    """The PUMA with another palm and other fingers, which begin `fingers_m` from the sensor."""
    parts = [palm]
    for name, side in (("finger_a", 1), ("finger_b", -1)):
        box = _box(0.02, 0.012, long_m, 0.5 * long_m, 0.006 * side)
        parts.append(
            f'<joint name="{name}_slide" type="prismatic">\n<parent link="palm"/>\n<child link="{name}"/>\n'
            f'<origin xyz="0 0 {fingers_m}"/>\n<axis xyz="0 {side} 0"/>\n'
            f'<limit lower="0" upper="{half_m}" effort="100" velocity="0.2"/>\n</joint>\n'
            + _link(name, finger_kg, 0.5 * long_m, box, 3e-5 * finger_kg / FINGER_KG, 0.006 * side)
        )
    parts.append(
        f'<joint name="tcp_mount" type="fixed">\n<parent link="palm"/>\n<child link="tcp"/>\n'
        f'<origin xyz="0 0 {tcp_m}"/>\n</joint>\n<link name="tcp"/>\n'
    )
    return re.sub(r'<link name="palm">.*</robot>', "".join(parts) + "</robot>", puma, flags=re.DOTALL)


def _coupler(puma: str) -> str:
    palm = _link("palm", COUPLER_KG, 0.0075, _box(0.05, 0.05, 0.015, 0.0075), 5e-5)
    return _urdf(puma, palm, 0.015, 0.026, 0.03, JAW_KG, OUT_M)


def _with(puma: str, name: str) -> str:
    wide_m, long_m, tcp_m, body_kg, opening_m, _, _ = FIGURES[name]
    boxes = _box(0.05, 0.05, 0.015, 0.0075) + _box(0.02, 0.044, 0.027, 0.0285) + _box(0.05, wide_m, 0.028, 0.056)
    mass_kg = round(COUPLER_KG + 2 * JAW_KG + body_kg, 3)
    at = (COUPLER_KG * 0.0075 + 2 * JAW_KG * 0.028 + body_kg * 0.056) / mass_kg
    return _urdf(puma, _link("palm", mass_kg, at, boxes, 6e-4), LENGTH_M, long_m, 0.5 * opening_m, FINGER_KG, tcp_m)


def _hand(name: str) -> CoupledHand:
    _, _, _, _, opening_m, grip_n, payload_kg = FIGURES[name]
    gripper = {"max_opening_m": opening_m, "max_force_n": grip_n}
    plain = {"name": name, "urdf": f"{name}.urdf", "srdf": "puma560.srdf", "payload_kg": payload_kg, "gripper": gripper}
    return msgspec.convert(plain, CoupledHand)


def _thing(name: str) -> Object:
    """A hand in its rack. Its origin, the centre of its mass, is at its fingers; its axes are those of the tool."""
    wide_m, long_m, _, body_kg, opening_m, _, _ = FIGURES[name]
    aside = 0.5 * opening_m + 0.006
    plain: dict[str, Any] = {
        "name": name,
        "kind": "hand",
        "seat": f"{name}-RACK",
        "mass_kg": body_kg + 2 * FINGER_KG,
        "inertia_kg_m2": [8e-4, 4e-4, 8e-4],
        "shapes": [
            {"name": "stub", "type": "box", "size_m": [0.02, 0.02, 0.024], "frame": {"xyz": [0, 0, OUT_M - LENGTH_M]}},
            {"name": "body", "type": "box", "size_m": [0.05, wide_m, 0.028], "frame": {"xyz": [0, 0, -0.014]}},
            *(
                {
                    "name": f"finger-{side}",
                    "type": "box",
                    "size_m": [0.02, 0.012, long_m],
                    "frame": {"xyz": [0, y, 0.5 * long_m]},
                }
                for side, y in (("a", aside), ("b", -aside))
            ),
        ],
        "grasp_points": [{"name": "COUPLING", "frame": {"xyz": [0, 0, OUT_M - LENGTH_M]}, "width_m": 0.02}],
    }
    return msgspec.convert(plain, Object)


def _rack(name: str) -> Seat:
    y, z = PLACES[name]
    plain = {
        "name": f"{name}-RACK",
        "kind": "hand-rack",
        "frame": {"xyz": [RACKS_M + LENGTH_M - OUT_M, y, z], "rpy_deg": [0, 90, 0]},
        "way_out": [0, 0, -1],
        "depth_m": 0.05,
        "detent_n": 10,
        "shapes": [{"name": "plate", "type": "box", "size_m": [0.06, 0.12, 0.01], "frame": {"xyz": [0, 0, 0.1]}}],
    }
    return msgspec.convert(plain, Seat)


def with_hands() -> Cell:
    cell = Cell.load("swapout")
    puma = cell.texts["puma560.urdf"]
    right, left = cell.arms
    gripper = {"max_opening_m": 0.06, "max_force_n": 60}
    coupled = {**msgspec.to_builtins(right), "urdf": "coupler.urdf", "payload_kg": 2.5, "gripper": gripper}
    arm = msgspec.structs.replace(msgspec.convert(coupled, Arm), hands=[_hand(name) for name in FIGURES])
    return msgspec.structs.replace(
        cell,
        name="tool-changer",
        arms=[arm, left],
        seats=[*cell.seats, *map(_rack, FIGURES)],
        objects=[*cell.objects, *map(_thing, FIGURES)],
        texts={**cell.texts, "coupler.urdf": _coupler(puma), **{f"{name}.urdf": _with(puma, name) for name in FIGURES}},
    )

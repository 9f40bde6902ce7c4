"""Small URDFs of arms of several kinds, written for the tests. Their shapes are boxes; their base is at the floor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

TURN, SLIDE = "revolute", "prismatic"


class Joint(NamedTuple):
    """A joint and the link that it carries: a box from the joint to the next one."""

    at: tuple[float, float, float]  # in the link before (m)
    axis: str
    size: tuple[float, float, float]  # of the box (m)
    middle: tuple[float, float, float]
    kg: float
    limits: tuple[float, float]  # rad or m
    kind: str = TURN
    effort: float = 100.0


def urdf(name: str, joints: Sequence[Joint], *, finger_kg: float = 0.0, same_names: bool = False) -> str:
    """The text of an arm. `finger_kg`: of each finger of a parallel hand of its own; 0: without a hand.
    `same_names`: each joint has the name of the link that it carries."""
    parts = [_link("base", (0.1, 0.1, 0.04), (0.0, 0.0, 0.02), 2.0)]
    before = "base"
    for n, joint in enumerate(joints, 1):
        link = f"link_{n}"
        parts.append(_joint(link if same_names else f"joint_{n}", before, link, joint))
        parts.append(_link(link, joint.size, joint.middle, joint.kg))
        before = link
    if finger_kg:
        parts += [_fixed("hand_mount", before, "hand", joints[-1].middle[2] + 0.5 * joints[-1].size[2] + 0.02)]
        parts += [_link("hand", (0.04, 0.16, 0.04), (0.0, 0.0, 0.0), 0.5)]
        for side, sign in (("left", 1), ("right", -1)):
            finger = Joint((0.0, 0.0, 0.02), f"0 {sign} 0", (0.02, 0.01, 0.05), (0.0, sign * 0.005, 0.025), finger_kg,
                           (0.0, 0.04), SLIDE, 20.0)  # fmt: skip
            parts.append(_joint(f"{side}_slide", "hand", f"{side}_finger", finger))
            parts.append(_link(f"{side}_finger", finger.size, finger.middle, finger.kg))
    return f'<robot name="{name}">\n' + "\n".join(parts) + "\n</robot>\n"


def _link(name: str, size: Sequence[float], middle: Sequence[float], kg: float) -> str:
    x, y, z = (side * side for side in size)
    ixx, iyy, izz = (kg / 12.0 * (a + b) for a, b in ((y, z), (x, z), (x, y)))
    return f"""  <link name="{name}">
    <inertial><origin xyz="{_xyz(middle)}"/><mass value="{kg}"/>
      <inertia ixx="{ixx:.9f}" iyy="{iyy:.9f}" izz="{izz:.9f}" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="{_xyz(middle)}"/><geometry><box size="{_xyz(size)}"/></geometry></collision>
  </link>"""


def _joint(name: str, parent: str, child: str, joint: Joint) -> str:
    low, high = joint.limits
    return f"""  <joint name="{name}" type="{joint.kind}">
    <parent link="{parent}"/><child link="{child}"/><origin xyz="{_xyz(joint.at)}"/><axis xyz="{joint.axis}"/>
    <limit lower="{low}" upper="{high}" effort="{joint.effort}" velocity="2"/>
  </joint>"""


def _fixed(name: str, parent: str, child: str, up: float) -> str:
    return (
        f'  <joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 {up}"/></joint>'
    )


def _xyz(values: Sequence[float]) -> str:
    return " ".join(f"{value:g}" for value in values)


def scaled(joint: Joint, factor: float) -> Joint:
    """The joint with its link, smaller or larger; no side gets thinner than 30 mm."""
    at, middle = (tuple(factor * x for x in one) for one in (joint.at, joint.middle))
    return joint._replace(at=at, middle=middle, size=tuple(max(0.03, factor * x) for x in joint.size))


ALL_ROUND = (-2.9, 2.9)


def _bar(
    at: float, axis: str, length: float, kg: float, limits: tuple[float, float] = ALL_ROUND, **more: float
) -> Joint:
    """A joint `at` this height in the link before, and a link of this length upwards."""
    return Joint((0.0, 0.0, at), axis, (0.06, 0.06, length - 0.02), (0.0, 0.0, 0.5 * length), kg, limits, **more)


#: an arm with six turning joints, straight up at zero
SIX = [
    _bar(0.05, "0 0 1", 0.25, 4.0),
    _bar(0.25, "0 1 0", 0.35, 4.0, (-2.0, 2.0), effort=150.0),
    _bar(0.35, "0 1 0", 0.30, 3.0, (-2.7, 2.7)),
    _bar(0.30, "0 0 1", 0.10, 1.0),
    _bar(0.10, "0 1 0", 0.10, 1.0, (-2.2, 2.2)),
    _bar(0.10, "0 0 1", 0.05, 0.5),
]
#: without the roll of the forearm: the hand can point down everywhere, but not everywhere with any tilt
FIVE = [SIX[0], SIX[1], SIX[2], _bar(0.30, "0 1 0", 0.10, 1.0, (-2.2, 2.2)), SIX[5]]
#: a SCARA: two parallel joints, a slide down, and the turn of the hand
SCARA = [
    Joint((0.0, 0.0, 0.45), "0 0 1", (0.36, 0.06, 0.06), (0.18, 0.0, 0.0), 4.0, (-2.6, 2.6)),
    Joint((0.36, 0.0, 0.07), "0 0 1", (0.26, 0.06, 0.06), (0.13, 0.0, 0.0), 3.0, (-2.6, 2.6)),
    Joint((0.26, 0.0, 0.0), "0 0 -1", (0.03, 0.03, 0.10), (0.0, 0.0, -0.08), 1.0, (0.0, 0.33), SLIDE, 200.0),
    Joint((0.0, 0.0, -0.14), "0 0 -1", (0.04, 0.04, 0.03), (0.0, 0.0, -0.02), 0.5, ALL_ROUND),
]
#: arms whose front is not the x axis of their base: to the right, and behind on the left
RIGHT = [FIVE[0]._replace(limits=(-2.6, -0.5)), *FIVE[1:]]
BEHIND = [SCARA[0]._replace(limits=(1.4, 3.2)), *SCARA[1:]]
#: a portal with three slides: its hand always points down, with one yaw
PORTAL = [
    Joint((-0.1, 0.0, 0.75), "1 0 0", (0.05, 1.0, 0.05), (0.0, 0.0, 0.0), 8.0, (0.0, 0.9), SLIDE, 300.0),
    Joint((0.0, 0.0, 0.0), "0 1 0", (0.06, 0.06, 0.06), (0.08, 0.0, 0.0), 4.0, (-0.45, 0.45), SLIDE, 300.0),
    Joint((0.16, 0.0, 0.0), "0 0 -1", (0.05, 0.05, 0.30), (0.0, 0.0, -0.17), 2.0, (0.0, 0.40), SLIDE, 300.0),
]

"""Loops over the joints of an arm, unrolled: functions that are generated for a number of joints.

A loop in Python costs more than the arithmetic on six numbers. Unrolling the two loops of this module takes 4 us off a
tick of 1 ms with two arms: 60 -> 56, of which the step of the physics library takes 30 (150 alternating pairs).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

from rtc.subsystems.motion.arm import Motion

# (joints, speeds, fingers, speeds of the fingers, reaction) of pybullet's states of these joints.
Split = Callable[
    [Sequence[Any]], tuple[list[float], list[float], tuple[float, float], tuple[float, float], tuple[float, ...]]
]
# (pack_into, buffer, wanted motion, q, v, stiffness, damping)
Fill = Callable[[Callable[..., None], memoryview, Motion, list[float], list[float], float, float], None]


@cache
def split_states(joints: int) -> Split:
    """A function that splits pybullet's joint states (position, speed, reaction, torque) of an arm with so many joints,
    two fingers, and the joint of the wrist sensor."""
    return _generated(f"""
def generated(states):
    {_each("(q{0}, v{0}, _, _)", joints)}, (left, left_v, _, _), (right, right_v, _, _), (_, _, reaction, _) = states
    return [{_each("q{0}", joints)}], [{_each("v{0}", joints)}], (left, right), (left_v, right_v), reaction
""")


@cache
def fill_computed_torque(joints: int) -> Fill:
    """A function that writes q, v and the acceleration that the inverse dynamics must cause: that of the wanted motion,
    and that of a spring and a damper of a unit mass on each joint."""
    return _generated(f"""
def generated(pack_into, buffer, wanted, q, v, stiffness, damping):
    ({_each("qw{0}", joints)},), ({_each("vw{0}", joints)},), ({_each("aw{0}", joints)},) = wanted
    {_each("q{0}", joints)}, = q
    {_each("v{0}", joints)}, = v
    pack_into(
        buffer, 0, {_each("q{0}", joints)}, {_each("v{0}", joints)},
        {_each("aw{0} + stiffness * (qw{0} - q{0}) + damping * (vw{0} - v{0})", joints)}
    )
""")


def _each(template: str, joints: int) -> str:
    return ", ".join(template.format(n) for n in range(joints))


def _generated(source: str) -> Any:
    namespace: dict[str, Any] = {}
    exec(source, namespace)
    return namespace["generated"]

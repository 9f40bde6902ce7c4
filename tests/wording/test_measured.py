"""Figures in words."""

from __future__ import annotations

import math

import pytest

from rtc.protocol.outcomes import Measured
from rtc.spatial import geometry
from rtc.wording.measured import _rpy, duration, in_words


@pytest.mark.parametrize(
    ("value_s", "words"),
    [
        (5.6e-16, "0.1 s"),
        (0.42, "0.42 s"),
        (4.2, "4.2 s"),
        (59.0, "59 s"),
        (60.0, "1 min"),
        (3600.0, "1 h"),
        (9960.0, "2 h 46 min"),
    ],
)
def test_durations(value_s: float, words: str) -> None:
    assert duration(value_s) == words


def test_only_what_was_asked_for_is_a_line() -> None:
    assert in_words(Measured(arm="LEFT-ARM", joints=[math.pi / 2, -0.0])) == ["LEFT-ARM joints: 90.0 0.0 deg"]


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ({"motor_c": [41.523456, 40], "hot": True}, "motor_c 41.52 40, hot True"),
        (12345.6, "12345.6"),
        ("not measured: no sensor", "not measured: no sensor"),
    ],
)
def test_an_item_of_a_package(value: object, words: str) -> None:
    assert in_words(Measured(arm="LEFT-ARM", others={"TEMPERATURE": value})) == [f"LEFT-ARM temperature: {words}"]


def test_all_of_it() -> None:
    pose = geometry.from_rpy([0.48, -0.085, 0.7], [0.1, 0.2, -0.3]).tolist()
    lines = in_words(
        Measured(arm="LEFT-ARM", tcp_pose=pose, wrench=[1, 0, -2, 0, 0.5, 0], peak_force_n=3.0, peak_torque_nm=0.6)
    )

    assert lines == [
        "LEFT-ARM pose: x 48.0 y -8.5 z 70.0 cm, roll 5.7 pitch 11.5 yaw -17.2 deg",
        "LEFT-ARM forces: 1.0 0.0 -2.0 N, torques: 0.00 0.50 0.00 Nm (tool axes); peak on the way 3.0 N, 0.60 Nm",
    ]


@pytest.mark.parametrize("rpy", [[0.1, 0.2, 0.3], [-3.0, 1.2, 2.0], [0.0, math.pi / 2, 0.4], [0.0, -math.pi / 2, 0.4]])
def test_angles_turn_back_into_the_same_attitude(rpy: list[float]) -> None:
    pose = geometry.from_rpy([0, 0, 0], rpy)

    again = geometry.from_rpy([0, 0, 0], _rpy(*pose[3:].tolist()))

    assert geometry.angle(pose, again) < 1e-6


def test_a_hand_that_points_straight_has_one_spelling() -> None:
    """A simulator is never exactly at the pole."""
    pose = geometry.from_rpy([0.45, 0.885, 0.6], [1.8, math.pi / 2 - 2e-6, 1.8]).tolist()
    assert "roll 0.0 pitch 90.0 yaw 0.0 deg" in in_words(Measured(arm="LEFT-ARM", tcp_pose=pose))[0]


def test_a_joint_that_slides_is_in_millimetres():
    measured = Measured(arm="PORTAL-ARM", joints=[0.25, -0.0312, 1.5707963], slides=[0, 1])
    assert in_words(measured) == ["PORTAL-ARM joints: 250.0 mm, -31.2 mm, 90.0 deg"]

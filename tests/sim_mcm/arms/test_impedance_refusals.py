"""Figures that no compliant arm can keep are refused before anything moves."""

from __future__ import annotations

import msgspec
import pytest

from rtc.model.robot.kinematics import ArmModel
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Reflex, StopReason
from rtc.subsystems.motion.executor import Executor
from sim_mcm.arms.kinematic_arm import KinematicCell
from sim_mcm.arms.servo import Servo

GOOD = [1000.0] * 3 + [30.0] * 3


@pytest.fixture(scope="module")
def model(cell) -> ArmModel:
    return ArmModel.of(cell, "RIGHT-ARM")


@pytest.mark.parametrize(
    ("figures", "words"),
    [
        ({"stiffness": [-1.0, *GOOD[1:]]}, "0 or more"),
        ({"stiffness": [float("nan"), *GOOD[1:]]}, "0 or more"),
        ({"stiffness": GOOD[:3]}, "6 figures"),
        ({"stiffness": GOOD, "damping": [0.0] * 6}, "damping"),
        ({"stiffness": GOOD, "wrench": [1.0] * 3}, "6 figures"),
        ({"stiffness": GOOD, "wrench": [float("inf"), *[None] * 5]}, "finite"),
        ({"stiffness": GOOD, "most_n": 0.0}, "above 0"),
        ({"stiffness": GOOD, "approach_m_s": float("nan")}, "above 0"),
        ({"stiffness": GOOD, "frame": "camera"}, "camera"),
        ({"stiffness": GOOD, "centre": [0.1, 0.2]}, "centre of compliance"),
        ({"stiffness": GOOD, "centre": [0.1, 0.2, float("nan")]}, "centre of compliance"),
        ({"stiffness": GOOD, "centre": [0.1, 0.2, 11.0]}, "centre of compliance"),
        ({"stiffness": GOOD, "profile": {"time_s": [0.0, 1.0], "share": [0.0, 1.0]}}, "needs a force set-point"),
        ({"stiffness": GOOD, "profile": {"time_s": [0.0], "share": [1.0]}}, "two times"),
        ({"stiffness": GOOD, "profile": {"time_s": [0.0, 1.0], "share": [1.0]}}, "two times"),
        ({"stiffness": GOOD, "profile": {"time_s": [1.0, 2.0], "share": [0.0, 1.0]}}, "two times"),
        ({"stiffness": GOOD, "profile": {"time_s": [0.0, 0.0], "share": [0.0, 1.0]}}, "must rise"),
        ({"stiffness": GOOD, "profile": {"time_s": [0.0, float("nan")], "share": [0.0, 1.0]}}, "must rise"),
        ({"stiffness": GOOD, "profile": {"time_s": [0.0, 1.0], "share": [0.0, 1.5]}}, "0 to 1"),
    ],
)
def test_impossible_figures_do_not_decode(figures: dict, words: str) -> None:
    with pytest.raises(msgspec.ValidationError, match=words):
        msgspec.convert(figures, p.Compliance)


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (p.ControlLaw(name="impedance"), "needs the figures"),
        (p.ControlLaw(compliance=p.Compliance(stiffness=GOOD)), "position has no compliance"),
        (p.ControlLaw(name="impedance", compliance=p.Compliance(stiffness=[6000.0, *GOOD[1:]])), "6000 N/m"),
        (p.ControlLaw(name="impedance", compliance=p.Compliance(stiffness=[*GOOD[:5], 400.0])), "400 N.m/rad"),
        (
            p.ControlLaw(
                name="impedance", compliance=p.Compliance(stiffness=GOOD, wrench=[None, None, 2000.0, *[None] * 3])
            ),
            "its motor has",
        ),
        (p.ControlLaw(name="impedance", gains={"wn": 900.0}, compliance=p.Compliance(stiffness=GOOD)), "wn 900"),
    ],
)
def test_a_law_beyond_the_arm_is_refused_and_the_old_one_stays(cell, model, law: p.ControlLaw, words: str) -> None:
    home = cell.arm("RIGHT-ARM").home_rad
    servo = Servo(model, home)
    with pytest.raises(ValueError, match=words):
        servo.use_law(law, home)
    assert servo.torque(home, [0.0] * 6) == pytest.approx([0.0] * 6, abs=1e-9)


def test_an_exact_arm_refuses_to_comply(cell, make) -> None:
    executor = Executor(KinematicCell(cell).arms["RIGHT-ARM"])
    law = p.ControlLaw(name="impedance", compliance=p.Compliance(stiffness=GOOD))
    answer = executor.accept(make.primitive(p.HoldStill(duration_s=1.0), control_law=law), 0.0)[0]
    assert isinstance(answer, m.EndReport)
    assert answer.reason is StopReason.REFUSED
    assert "exact arm" in answer.message  # wording: of a report, which has no cause


def test_an_exact_arm_refuses_the_reflex_comply(cell, make) -> None:
    executor = Executor(KinematicCell(cell).arms["RIGHT-ARM"])
    trip = make.stop(StopReason.CONTACT, p.ForceAbove(limit_n=5.0), Reflex.COMPLY)
    answer = executor.accept(make.primitive(p.HoldStill(duration_s=1.0), trip), 0.0)[0]
    assert isinstance(answer, m.EndReport)
    assert answer.reason is StopReason.REFUSED
    assert "exact arm" in answer.message  # wording: of a report, which has no cause

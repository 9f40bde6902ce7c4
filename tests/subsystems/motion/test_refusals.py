"""Primitives that the executor refuses: the reason in words, and nothing moves."""

from __future__ import annotations

import re

import pytest

from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import Reflex, StopReason
from rtc.subsystems.motion.modes import Mode


def test_a_second_primitive_is_refused_while_one_is_executed(rig) -> None:
    rig.accept(rig.swing())
    rig.tick(100)

    answer = rig.accept(rig.swing(id="C-8.1"))

    assert isinstance(answer, m.EndReport)
    assert (answer.primitive, answer.reason) == ("C-8.1", StopReason.REFUSED)
    assert rig.until_end().primitive == "C-7.1"


def _bad(rig, make, kind: str) -> p.Primitive:
    home, away = rig.home, rig.away
    path = make.joint_path
    beyond = [home[0], home[1], home[2], home[3], 2.0, home[5]]
    moving = p.JointTrajectory(
        space="joint", time_s=[0.0, 1.0], positions=[home, away], velocities=[[0.0] * 6, [0.3] * 6],
        accelerations=[[0.0] * 6] * 2,
    )  # fmt: skip
    quick = p.JointTrajectory(
        space="joint", time_s=[0.0, 1.0, 2.0], positions=[home, away, away],
        velocities=[[0.0] * 6, [9.0, 0, 0, 0, 0, 0], [0.0] * 6], accelerations=[[0.0] * 6] * 3,
    )  # fmt: skip
    swing = path(home, away, 1.0)
    contact = StopReason.CONTACT
    not_finite = p.ReportCondition(n=0, when=p.ForceAbove(limit_n=float("nan")))
    return {
        "elsewhere": lambda: make.primitive(path([home[0] + 0.2, *home[1:]], away, 1.0)),
        "beyond": lambda: make.primitive(path(home, beyond, 1.0)),
        "joints": lambda: make.primitive(path(home[:5], away[:5], 1.0)),
        "nan": lambda: make.primitive(path(home, [float("nan"), *away[1:]], 1.0)),
        "moving": lambda: make.primitive(moving),
        "quick": lambda: make.primitive(quick),
        "law": lambda: make.primitive(swing, control_law=p.ControlLaw(name="magic")),
        "gain": lambda: make.primitive(swing, control_law=p.ControlLaw(gains={"wn": 500.0})),
        "box": lambda: make.primitive(swing, make.stop(contact, p.TcpInside(centre=[0.0] * 3, size_m=[1.0] * 3))),
        "attitude": lambda: make.primitive(swing, make.stop(contact, p.TcpTurned(attitude=[0.0] * 4, limit_rad=1.0))),
        "axis": lambda: make.primitive(swing, make.stop(contact, p.ForceAbove(limit_n=5.0, axis=[1.0, 0.0]))),
        "limit": lambda: make.primitive(swing, make.stop(contact, p.ForceAbove(limit_n=float("nan")))),
        "wide": lambda: make.primitive(p.HandMotion(width_m=0.2, force_n=10.0)),
        "strong": lambda: make.primitive(p.HandMotion(width_m=0.0, force_n=500.0)),
        "period": lambda: make.primitive(swing, reporting=p.Reporting(every_s=0.0)),
        "no way": lambda: make.primitive(swing, make.stop(contact, p.ForceAbove(limit_n=5.0), Reflex.BACK_OFF)),
        "no reflex": lambda: make.primitive(swing, make.stop(contact, p.ForceAbove(limit_n=5.0), Reflex.STOP, 0.02)),
        "not finite": lambda: make.primitive(swing, reporting=p.Reporting(when=[not_finite])),
    }[kind]()


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("elsewhere", r"joint_1 is at 0\.\d+ rad, the trajectory starts at 0\.\d+, \+0\.2000 away"),
        ("beyond", r"position of joint_5 reaches 2 rad; its limits are -1\.7453 and 1\.7453"),
        ("joints", "5 joints, RIGHT-ARM has 6"),
        ("nan", "not finite"),
        ("moving", "does not end at rest"),
        ("quick", r"velocity of joint_1 reaches 9 rad/s"),
        ("law", "there is no control law magic; there are impedance, position"),
        ("gain", "wn 500.0 rad/s is outside 10 to 300"),
        ("axis", "3 numbers are needed"),
        ("box", "centre: 7 numbers are needed"),
        ("attitude", "four zeros"),
        ("limit", "not a finite number"),
        ("wide", "width_m 0.2 is outside 0.0 to 0.08"),
        ("strong", "force_n 500.0 is outside"),
        ("period", "every 0.0 s"),
        ("no way", "back_off_m of contact is 0 m with the reflex back_off"),
        ("no reflex", "back_off_m of contact is 0.02 m with the reflex stop"),
        ("not finite", "not a finite number"),
    ],
)
def test_what_cannot_be_done_is_refused_in_words_and_moves_nothing(rig, make, kind: str, words: str) -> None:
    answer = rig.accept(_bad(rig, make, kind))

    assert isinstance(answer, m.EndReport)
    assert answer.reason is StopReason.REFUSED
    assert re.search(words, answer.message)  # wording: what is wrong with the primitive
    rig.tick(10)
    assert rig.arm.commands == []
    assert rig.executor.state is Mode.HOLDING


@pytest.mark.parametrize("error", [ZeroDivisionError("1/0"), OverflowError("too much"), TypeError("no")])
def test_whatever_a_control_law_raises_is_an_objection(rig, error: Exception) -> None:
    def use_law(law: p.ControlLaw) -> None:
        raise error

    rig.arm.use_law = use_law
    answer = rig.accept(rig.swing())
    assert isinstance(answer, m.EndReport)
    assert answer.reason is StopReason.REFUSED
    assert type(error).__name__ in answer.message  # wording: whose code has failed
    assert rig.executor.state is Mode.HOLDING

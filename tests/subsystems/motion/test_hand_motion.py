"""Motions of a hand: its width, its force, and what a halt leaves of both."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.subsystems.motion import goals
from rtc.subsystems.motion.arm import HandCommand


def test_a_hand_goes_to_its_width(rig, make) -> None:
    rig.accept(make.primitive(p.HandMotion(width_m=0.03, force_n=20.0)))
    report = rig.until_end()
    assert report.reason is StopReason.GOAL
    assert report.hand_width_m == pytest.approx(0.03, abs=0.0006)


def test_a_hand_that_presses_with_all_its_force_has_reached_its_goal_and_keeps_it(rig, make) -> None:
    rig.accept(make.primitive(p.HandMotion(width_m=0.0, force_n=30.0)))
    rig.tick(100)
    rig.arm.forces = (30.0, 29.0)
    report = rig.until_end()
    assert report.reason is StopReason.GOAL
    assert report.hand_force_n == 29.0

    rig.accept(rig.swing(id="C-7.2"))
    rig.until_end()
    assert rig.arm.hand.force_n == 30.0  # all the way
    assert rig.arm.hand.width_m == 0.0


@pytest.mark.parametrize(
    ("presses_n", "after_s", "arrived"), [(45.0, 0.1, False), (31.0, 0.1, True), (45.0, 0.3, True), (28.0, 0.3, False)]
)
def test_a_hand_that_shall_press_less_has_reached_its_goal_when_it_does_or_after_a_while(presses_n, after_s, arrived):
    """Then something else presses its fingers."""
    sample = SimpleNamespace(finger_forces=(presses_n, presses_n))
    seen = SimpleNamespace(fingers_rest=lambda: True, width_m=0.02, grip_n=presses_n, sample=sample)
    found = goals.arrival(p.HandMotion(width_m=0.0, force_n=30.0), seen, 0.0, lambda: 0.0)(after_s)
    assert (found is not None) is arrived


@pytest.mark.parametrize(("share", "grips"), [(0.9, True), (0.65, True), (0.55, False)])
def test_a_hand_that_exerts_less_than_commanded_has_gripped_when_it_presses_no_harder(share, grips):
    """Its own figure is not the evidence: it would echo the command."""
    sample = SimpleNamespace(finger_forces=(0.0, 0.0))
    seen = SimpleNamespace(fingers_rest=lambda: True, width_m=0.02, grip_n=0.0, sample=sample)
    arrived = goals.arrival(p.HandMotion(width_m=0.0, force_n=30.0), seen, 0.0, lambda: 0.0)
    for tick in range(1000):  # 150 N/s, as the hand of the simulation
        pressed = min(0.15 * tick, share * 30.0)
        sample.finger_forces, seen.grip_n = (pressed, pressed), pressed
        if arrived(0.001 * tick) is not None:
            assert grips
            assert pressed == share * 30.0  # not while the force still rises
            return
    assert not grips


def test_opening_a_hand_that_still_presses_is_not_yet_the_goal(rig, make) -> None:
    rig.arm.width, rig.arm.forces = 0.02, (30.0, 30.0)
    rig.arm.hand = HandCommand(0.02, 30.0, 0.05)
    rig.accept(make.primitive(p.HandMotion(width_m=0.08, force_n=30.0)))
    report = rig.until_end()
    assert report.hand_width_m == pytest.approx(0.08, abs=0.0006)


def test_halting_a_hand_stops_it_where_it_is(rig, make) -> None:
    rig.accept(make.primitive(p.HandMotion(width_m=0.0, force_n=30.0)))
    rig.tick(400)
    rig.executor.halt()
    report = rig.until_end()
    assert report.reason is StopReason.HALT
    width = report.hand_width_m
    rig.tick(500)
    assert rig.arm.width == pytest.approx(width, abs=0.0005)
    assert 0.05 < width < 0.07


def test_what_is_squeezed_stays_squeezed_through_a_halt_and_no_harder(rig, make) -> None:
    rig.accept(make.primitive(p.HandMotion(width_m=0.0, force_n=30.0)))
    rig.tick(400)
    rig.arm.forces = (12.0, 12.0)
    rig.tick(1)
    rig.executor.halt()
    rig.until_end()
    assert rig.arm.hand == HandCommand(0.0, 12.0, 0.05)

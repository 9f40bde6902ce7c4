"""The hand's servo on two point masses, with and without a stiff thing between the fingers."""

from __future__ import annotations

import pytest

from rtc.subsystems.motion.arm import TICK_S, HandCommand
from sim_mcm.arms.hand import SimulatedHand

FINGER_KG = 0.1
WALL_N_M, WALL_NS_M = 100_000.0, 50.0


class Fingers:
    """Two fingers of a hundred grams, a wall for each (m from the middle; None = nothing there)."""

    def __init__(self, width_m: float, walls: tuple[float | None, float | None] = (None, None)) -> None:
        self.hand = SimulatedHand(HandCommand(width_m, 60.0, 0.05), width_m)
        self.at = [0.5 * width_m] * 2
        self.speed = [0.0, 0.0]
        self.walls = walls
        self.forces = (0.0, 0.0)
        self.pressed = (0.0, 0.0)

    @property
    def width(self) -> float:
        return sum(self.at)

    def run(self, command: HandCommand, ticks: int) -> None:
        self.hand.command = command
        for _ in range(ticks):
            *forces, self.pressed = self.hand.forces((self.at[0], self.at[1]), (self.speed[0], self.speed[1]))
            self.forces = (forces[0], forces[1])
            for n, (force, wall) in enumerate(zip(self.forces, self.walls, strict=True)):
                if wall is not None and self.at[n] < wall:
                    force += WALL_N_M * (wall - self.at[n]) - WALL_NS_M * self.speed[n]
                self.speed[n] += force / FINGER_KG * TICK_S
                self.at[n] += self.speed[n] * TICK_S


def test_an_empty_hand_goes_to_its_width_at_its_speed() -> None:
    fingers = Fingers(0.08)
    fingers.run(HandCommand(0.03, 30.0, 0.05), 500)
    assert fingers.width == pytest.approx(0.08 - 0.05 * 0.5, abs=0.003)
    fingers.run(HandCommand(0.03, 30.0, 0.05), 1000)
    assert fingers.width == pytest.approx(0.03, abs=0.0005)
    assert max(fingers.pressed) < 1.0


@pytest.mark.parametrize("width_m", [0.0, 0.01, 0.018])
@pytest.mark.parametrize("force_n", [5.0, 30.0, 60.0])
def test_closing_on_a_thing_ends_with_the_commanded_force_on_both_sides(width_m: float, force_n: float) -> None:
    fingers = Fingers(0.08, walls=(0.01, 0.01))
    fingers.run(HandCommand(width_m, force_n, 0.05), 2500)
    assert fingers.pressed == pytest.approx((force_n, force_n), rel=0.02)
    assert fingers.width == pytest.approx(0.02, abs=0.0015)


def test_a_thing_aside_is_pressed_towards_the_middle() -> None:
    fingers = Fingers(0.08, walls=(0.012, 0.008))
    fingers.run(HandCommand(0.0, 30.0, 0.05), 2500)
    a, b = fingers.pressed
    assert a > 30.0 > b
    assert a + b == pytest.approx(60.0, rel=0.02)


def test_opening_lets_go() -> None:
    fingers = Fingers(0.08, walls=(0.01, 0.01))
    fingers.run(HandCommand(0.0, 30.0, 0.05), 2500)
    fingers.run(HandCommand(0.08, 30.0, 0.05), 2500)
    assert fingers.width == pytest.approx(0.08, abs=0.001)


def test_a_lost_thing_does_not_make_the_fingers_slam() -> None:
    fingers = Fingers(0.08, walls=(0.01, 0.01))
    fingers.run(HandCommand(0.0, 30.0, 0.05), 2500)
    fingers.walls = (None, None)
    fingers.run(HandCommand(0.0, 30.0, 0.05), 1500)
    assert fingers.width == pytest.approx(0.0, abs=0.001)
    assert max(fingers.pressed) < 1.0  # which is how it is found out


@pytest.mark.parametrize("pushed_m", [0.0003, 0.0005, 0.0006, 0.001, 0.002])
def test_a_finger_that_is_pushed_aside_meets_a_spring_and_rests(pushed_m: float) -> None:
    """The setpoint ran while the opening was off by more than half a millimetre, and stood while it was not: the finger
    shook by 0.05 mm, and each touch waited a second for its rest."""
    fingers = Fingers(0.076)
    reach = HandCommand(0.076, 20.0, 0.05)
    fingers.run(reach, 100)
    fingers.walls = (0.038 + pushed_m, None)
    fingers.run(reach, 1000)
    before = fingers.at[0]
    fingers.run(reach, 20)
    assert fingers.at[0] == pytest.approx(before, abs=1e-6)
    assert fingers.pressed[0] == pytest.approx(6000.0 * pushed_m, rel=0.1)  # 6 N/mm

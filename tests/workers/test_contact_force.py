"""A sentence keeps the force that it promises, on bodies that are not where they are believed to be; in physics.

`tests.campaigns.contact_force` measures the whole table.
"""

from __future__ import annotations

from collections.abc import Callable

import pybullet
import pytest

from rtc.protocol.outcomes import StopReason
from tests.campaigns.contact_force import ARM, BODIES, CLAUSES, FREE, MAX_RATIO, Clause, Touch, meet

pytestmark = pytest.mark.physics
PALM = 7  # link of the URDF


def met(body: str, clause: Clause, speed_cm_s: float) -> Touch:
    touch = meet(body, clause, speed_cm_s)
    assert isinstance(touch, Touch), touch
    return touch


@pytest.mark.parametrize(
    ("body", "name", "speed_cm_s"),
    [
        ("wall", "GUARDED", 10.0),
        ("wall", "GUARDED", 1.0),
        ("wall", "STIFFNESS 200 N/M", 5.0),
        ("wall before a held module", "GUARDED", 5.0),
        ("handle before a fingertip", "GUARDED", 10.0),
        ("handle beside a finger", "GUARDED", 10.0),
    ],
)
def test_a_promised_force_is_kept_at_any_stated_speed(body: str, name: str, speed_cm_s: float) -> None:
    """They met 57 to 500 N."""
    promised_n = CLAUSES[name].promised_n
    assert promised_n is not None
    assert name in BODIES[body]
    touch = met(body, CLAUSES[name], speed_cm_s)
    assert 1.0 < touch.peak_n <= MAX_RATIO * promised_n
    assert touch.reason in ("force_limit", "timeout")


def test_a_force_on_a_free_way_is_called_a_collision_stop_with_what_is_felt() -> None:
    touch = met("wall", CLAUSES[f"{FREE}FORCE-LIMIT 10 N"], 5.0)
    assert touch.peak_n > 100.0
    assert "10 N is a collision stop on this free way: at 50 mm/s" in touch.message  # wording: what is felt


@pytest.fixture
def at_home(physical) -> Callable[[float], None]:
    """Makes a force (N, downwards) act at the tcp of the arm from then on."""
    world = physical.subsystem.sim
    arm = world.arms[ARM]

    def push(force_n: float) -> None:
        def disturb(tick: int) -> None:
            if tick > 200:
                at, client = arm.tcp_pose(arm._sample.joints)[:3].tolist(), world.world.client
                down = [0.0, 0.0, -force_n]
                pybullet.applyExternalForce(arm.body, PALM, down, at, pybullet.WORLD_FRAME, physicsClientId=client)

        physical.subsystem.disturb = disturb

    return push


@pytest.mark.parametrize(
    ("force_n", "clause", "reason"),
    [(30.0, "GUARDED", StopReason.GOAL), (60.0, "GUARDED", StopReason.FORCE_LIMIT), (60.0, "", StopReason.GOAL)],
)
def test_a_guarded_hold_ends_at_less_than_a_bare_one(physical, at_home, force_n, clause, reason) -> None:
    at_home(force_n)
    assert physical.do(f"HOLD {ARM} FOR 0.5 SEC {clause}").reports[-1].reason is reason

"""Exact arms: two arms that touch are noticed at the first contact, and bodies near an arm are found."""

from __future__ import annotations

import numpy as np
import pytest

from rtc.model.cells.cell import Cell
from rtc.model.robot.collision import CollisionWorld
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.subsystems.base.subsystem import BROKER
from rtc.subsystems.motion.clearance import Guide
from rtc.subsystems.motion.subsystem import McmSubsystem
from sim_mcm.arms.kinematic_arm import KinematicCell
from sim_mcm.period import period

CELL = Cell.load("swapout")
RIGHT, LEFT = "RIGHT-ARM", "LEFT-ARM"
ACROSS = np.radians([80.0, 0, 0, 0, 0, 0])  # of joint_1: the hands come together


@pytest.fixture
def sim() -> KinematicCell:
    return KinematicCell(CELL)


def put(sim: KinematicCell, joints: dict[str, np.ndarray]) -> None:
    for name, values in joints.items():
        sim.arms[name].joints = values.tolist()


def test_a_contact_of_two_arms_is_found_where_the_planner_finds_it(sim):
    world, home = CollisionWorld(CELL), {name: np.array(sim.arms[name].joints) for name in (RIGHT, LEFT)}
    met = []
    for share in np.linspace(0.0, 1.0, 60):
        joints = {RIGHT: home[RIGHT] + share * ACROSS, LEFT: home[LEFT] - share * ACROSS}
        put(sim, joints)
        hit = world.check(joints)
        both = hit is not None and {hit.body_a.split()[0], hit.body_b.split()[0]} == {RIGHT, LEFT}
        met.append((both, bool(sim.arms[RIGHT].arm_touches()), bool(sim.arms[LEFT].arm_touches())))
    assert any(both for both, _, _ in met)
    assert all(right == left for _, right, left in met)
    assert all(right for both, right, _ in met if both)
    first = next(n for n, (_, right, _) in enumerate(met) if right)
    assert any(both for both, _, _ in met[first : first + 2])


def test_a_contact_of_two_arms_stops_both(sim):
    mcm = McmSubsystem(sim.arms, pid=1)
    home = {name: np.array(sim.arms[name].joints) for name in (RIGHT, LEFT)}
    ends = {}
    for name, sign in ((RIGHT, 1.0), (LEFT, -1.0)):
        goal = home[name] + sign * ACROSS
        still = [[0.0] * 6] * 2
        way = p.JointTrajectory(
            space="joint",
            time_s=[0.0, 4.0],
            positions=[home[name].tolist(), goal.tolist()],
            velocities=still,
            accelerations=still,
        )
        stops = [
            p.StopFunction(reason=StopReason.GOAL, when=p.GoalReached()),
            p.StopFunction(reason=StopReason.TIMEOUT, when=p.TimeAbove(9.0)),
        ]
        made = p.Primitive(id=f"C-{2 + int(sign)}.1", performer=name, trajectory=way, stop_functions=stops)
        mcm.handle(m.Execute(primitive=made, pid=1), BROKER, 0.0)
    for tick in range(6000):
        sent = [message for _, message in period(mcm.tick, sim, 0.001 * tick)]
        ends |= {message.performer: message for message in sent if isinstance(message, m.EndReport)}
        if len(ends) == 2:
            break
    assert {end.reason for end in ends.values()} == {StopReason.ARM_CONTACT}
    assert np.abs(np.array(sim.arms[RIGHT].joints) - home[RIGHT]).max() < ACROSS.max() - 0.1


def test_bodies_near_an_arm_and_near_what_it_holds_are_found(sim):
    assert sim.arms[RIGHT].near(0.005) == []
    wide = sim.arms[RIGHT].near(0.9)
    owners = {one.body.split()[0] for one in wide}
    assert {"SATELLITE", "LEFT-ARM", "MACS-NEW"} <= owners
    assert min(one.distance_m for one in wide) > 0.005
    assert max(one.distance_m for one in wide) <= 0.9
    sim.carried["MACS-NEW"] = (RIGHT, np.array([0.0, 0.0, 0.19, 0.0, 0.0, 0.0, 1.0]))
    sim.step()
    wide = sim.arms[RIGHT].near(0.9)
    assert not any(one.body.startswith("MACS-NEW") for one in wide)
    beside = {one.body for one in wide if one.link.startswith("MACS-NEW")}
    assert {"SATELLITE right-panel", "RIGHT-ARM forearm"} <= beside
    assert not any(name.startswith("RIGHT-ARM finger") for name in beside)


@pytest.mark.parametrize("laden", [False, True])
def test_near_bodies_come_nearer_as_the_joints_that_move_them_say(sim, laden):
    """The distance of each pair, by the rates that a guided arm uses, against a small motion."""
    rng = np.random.default_rng(7)
    arm = sim.arms[RIGHT]
    guide = Guide(arm.jacobian)
    if laden:
        sim.carried["MACS-NEW"] = (RIGHT, np.array([0.0, 0.0, 0.19, 0.0, 0.0, 0.0, 1.0]))
    pairs = 0
    for _ in range(30):
        joints = np.array(CELL.arm(RIGHT).home_rad) + rng.uniform(-0.4, 0.4, 6)
        put(sim, {RIGHT: joints})
        near = [one for one in arm.near(0.2) if one.distance_m > 0.002]
        if not near:
            continue
        guide.see(joints.tolist(), arm.tcp_pose(joints), near, [0.0] * len(near))
        turn = 1e-4 * rng.normal(size=6)
        put(sim, {RIGHT: joints + turn})
        after = arm.near(0.21)
        for one, change in zip(near, guide._rates @ turn, strict=True):
            found = [n.distance_m for n in after if (n.link, n.body) == (one.link, one.body)]
            assert min(abs(m - one.distance_m - change) for m in found) < 2e-5
            pairs += 1
    assert pairs > 20

"""Two arms with crossing motions, commanded separately at the same time: Decision Unit, workers and MCM as one."""

from __future__ import annotations

import itertools

import pytest

from rtc.model.robot.collision_scene import Scene
from rtc.protocol.messages import SetPaused
from rtc.subsystems.base.subsystem import BROKER
from sim_mcm.arms.kinematic_arm import KinematicCell
from tests.campaigns.two_arms import Runner, random_pairs
from tests.workers.conftest import CELL, MODEL
from tests.workers.one_process import OneProcess, read_primitive

MIDDLE, RIGHT_SIDE, LEFT_SIDE = "POSITION 48 0 95 CM", "POSITION 48 -45 95 CM", "POSITION 48 40 95 CM"


@pytest.mark.physics
def test_crossing_pairs_of_motions_never_touch_in_physics():
    runner = Runner()
    try:
        runs = [runner.run(pair) for pair in itertools.islice(random_pairs(seed=11), 2)]
    finally:
        runner.close()
    assert [run.touches for run in runs] == [0] * 2
    assert all(set(run.kinds) == {"succeeded"} for run in runs), [run.causes for run in runs]
    assert any(run.overlap_s > 0.0 for run in runs)


@pytest.fixture
def cluster() -> OneProcess:
    return OneProcess(KinematicCell(CELL))


def phases(cluster: OneProcess, command: str) -> list[str]:
    return [note.phase.value for note in cluster.notes if note.command == command]


def test_a_command_waits_for_an_arm_that_is_where_it_goes_and_follows_when_it_leaves(cluster):
    cluster.give(f"MOVE RIGHT-ARM TO {MIDDLE}", client="ann")
    cluster.give(f"MOVE RIGHT-ARM TO {RIGHT_SIDE}", client="ann")
    cluster.give(f"MOVE LEFT-ARM TO {MIDDLE}", client="bob")
    cluster.run()
    assert {c: o.kind.value for c, o in cluster.outcomes.items()} == dict.fromkeys(("C-1", "C-2", "C-3"), "succeeded")
    assert "waiting" in phases(cluster, "C-3")
    both = cluster.moving["RIGHT-ARM"].keys() & cluster.moving["LEFT-ARM"].keys()
    assert both  # the left arm starts before the right one has arrived


def test_a_command_is_refused_if_the_arm_in_its_way_stays_there(cluster):
    cluster.give(f"MOVE RIGHT-ARM TO {MIDDLE}", client="ann")
    cluster.give(f"MOVE LEFT-ARM TO {MIDDLE}", client="bob")
    cluster.run()
    assert cluster.outcomes["C-1"].kind.value == "succeeded"
    assert cluster.outcomes["C-2"].kind.value == "refused"
    assert cluster.outcomes["C-2"].refusal.in_the_way == "RIGHT-ARM"
    assert "waiting" in phases(cluster, "C-2")


def test_motions_apart_from_each_other_do_not_wait(cluster):
    cluster.give("MOVE RIGHT-ARM TO RACK-1-FRONT", client="ann")
    cluster.give("MOVE LEFT-ARM TO RACK-2-FRONT", client="bob")
    cluster.run()
    begun = [min(cluster.moving[arm]) for arm in ("RIGHT-ARM", "LEFT-ARM")]
    assert abs(begun[0] - begun[1]) < 100  # ticks; the later one was planned again beside the earlier one
    assert "waiting" not in phases(cluster, "C-1") + phases(cluster, "C-2")


def crossing(cluster: OneProcess) -> None:
    """The right arm leaves the middle, and the left one, commanded at the same time to go there, follows it closely."""
    cluster.give(f"MOVE RIGHT-ARM TO {MIDDLE}", client="ann")
    cluster.run()
    cluster.give(f"MOVE RIGHT-ARM TO {RIGHT_SIDE}", client="ann")
    cluster.give(f"MOVE LEFT-ARM TO {MIDDLE}", client="bob")
    while "C-3.1" not in cluster.moving["LEFT-ARM"].values():
        cluster.tick()
    assert "C-2.1" in cluster.moving["RIGHT-ARM"].values()


def clearance_is(cluster: OneProcess, clearance_m: float) -> bool:
    joints = {arm: cluster.sim.arms[arm].read().joints for arm in cluster.sim.arms}
    return MODEL.collision.check(joints, Scene(clearance_m=clearance_m)) is None


def test_an_arm_that_is_halted_in_the_way_stops_the_one_that_follows_it_closely(cluster):
    crossing(cluster)
    cluster.give("HALT RIGHT-ARM", client="ann")
    cluster.run()
    assert cluster.outcomes["C-2"].kind.value == "halted"
    assert cluster.outcomes["C-3"].kind.value == "refused"  # planned again from where it stands, into an arm at rest
    assert cluster.outcomes["C-3"].refusal.in_the_way == "RIGHT-ARM"
    assert "C-3.1" in cluster.moving["LEFT-ARM"].values()
    assert clearance_is(cluster, 0.005)
    assert cluster.world.facts["LEFT-ARM.joints"].value == cluster.sim.arms["LEFT-ARM"].read().joints


def test_an_arm_that_pauses_in_the_way_is_waited_for_on_the_way(cluster):
    crossing(cluster)
    cluster.mcm.handle(SetPaused(primitive="C-2.1", paused=True), BROKER, cluster.now_s)
    for tick in range(4000):
        cluster.tick()
        assert tick % 50 or clearance_is(cluster, 0.005)
    assert cluster.mcm.executors["LEFT-ARM"].held_back
    cluster.mcm.handle(SetPaused(primitive="C-2.1", paused=False), BROKER, cluster.now_s)
    cluster.run()
    assert [cluster.outcomes[c].kind.value for c in ("C-2", "C-3")] == ["succeeded"] * 2
    assert set(cluster.moving["LEFT-ARM"].values()) == {"C-3.1"}  # it went on with the same motion


@pytest.mark.parametrize(
    ("sentence", "closely"),
    [
        (f"MOVE LEFT-ARM TO {MIDDLE}", True),
        (f"MOVE LEFT-ARM TO {MIDDLE} STRAIGHT-LINE", True),
        ("MOVE LEFT-ARM BY -40 CM ALONG Y", False),  # planned again from its way, it would go too far
    ],
)
def test_only_a_motion_to_a_fixed_place_waits_on_its_way(cluster, sentence, closely):
    cluster.give(f"MOVE RIGHT-ARM TO {MIDDLE}", client="ann")
    cluster.give(f"MOVE LEFT-ARM TO {LEFT_SIDE}", client="bob")
    cluster.run()
    cluster.give(f"MOVE RIGHT-ARM TO {RIGHT_SIDE}", client="ann")
    cluster.give(sentence, client="bob")
    while "LEFT-ARM" not in cluster.state.motions:
        cluster.tick()
    (condition,) = read_primitive(cluster.state.motions["LEFT-ARM"].body).start_after
    assert (condition.path_s > 0.0, bool(condition.further)) == (not closely, closely)


@pytest.mark.physics
def test_two_arms_that_touch_are_both_stopped_and_both_commands_fail():
    """The left arm stands in the way, and the world believes it elsewhere; it moves a little while it is hit."""
    runner = Runner()
    try:
        cluster = runner.at({"RIGHT-ARM": posture("RIGHT-ARM", -0.4), "LEFT-ARM": posture("LEFT-ARM", 0.0)})
        cluster.know_joints({"LEFT-ARM": posture("LEFT-ARM", 0.4)})
        cluster.give(f"MOVE RIGHT-ARM TO {MIDDLE}", client="ann")
        cluster.give("HOLD LEFT-ARM FOR 20 SEC", client="bob")
        cluster.run()
    finally:
        runner.close()
    ends = [(outcome.kind.value, outcome.stop) for outcome in cluster.outcomes.values()]
    assert ends == [("failed", "arm_contact")] * 2


def posture(arm: str, y_m: float) -> list[float]:
    """The hand level, before the bay."""
    pose = [0.48, y_m, 0.95, 0.0, 2**-0.5, 0.0, 2**-0.5]
    found: list[float] = MODEL.arms[arm].ik(pose, CELL.arm(arm).home_rad, 0.06)[0].tolist()
    return found

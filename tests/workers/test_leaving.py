"""An arm can always leave: after a stop, whatever it leans on, and whatever the other arm holds."""

from __future__ import annotations

import math

import msgspec
import pybullet
import pytest

from rtc.protocol.advice import sentences_of
from rtc.protocol.messages import EndReport, Validity
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import HandWidthBelow
from rtc.spatial import geometry
from tests.workers.conftest import Bench

ARM = "RIGHT-ARM"
PALM = 7  # link of the URDF


def force_n(bench: Bench, arm: str = ARM) -> float:
    """What the wrist sensor reads 0.3 s later."""
    for _ in range(300):
        bench.subsystem.tick()
    return math.hypot(*bench.subsystem.executors[arm].sample.wrench[:3])


@pytest.mark.physics
def test_a_hand_that_was_stopped_at_the_side_of_a_handle_does_not_press_on_it(physical: Bench) -> None:
    """Its fingers are springs: a command set to the measured joints once would leave it pressing with 11 N."""
    assert physical.do("APPROACH MACS-NEW AT HANDLE-A WITH RIGHT-ARM").succeeded
    assert physical.do(f"MOVE {ARM} BY 10 CM ALONG TOOL-Z").succeeded
    physical.subsystem.displace("MACS-NEW", [0.0, 0.015, 0.0])
    line = f"MOVE {ARM} BY -2.5 CM ALONG Y MAINTAIN SPEED 1 CM/S"
    report = physical.do(f"{line} UNLESS FORCE EXCEEDS 20 N THEN STOP").reports[-1]
    assert report.reason is StopReason.FORCE_LIMIT
    assert report.measured > 20.0
    assert force_n(physical) < 1.0


@pytest.mark.physics
def test_an_arm_that_something_turns_away_from_its_command_begins_the_next_sentence_where_it_is(
    physical: Bench,
) -> None:
    """A torque that no yielding relieves, as of a module that is wedged between the fingers and a wall."""
    sim = physical.subsystem.sim
    arm = sim.arms[ARM]

    def twist(tick: int) -> None:
        about = (0.4 * geometry.rotate(arm.tcp_pose(arm.read().joints), [0.0, 0.0, 1.0])).tolist()
        pybullet.applyExternalTorque(arm.body, PALM, about, pybullet.WORLD_FRAME, physicsClientId=sim.world.client)

    assert physical.do(f"MOVE {ARM} BY 5 CM ALONG DOWN").succeeded
    physical.subsystem.disturb = lambda tick: twist(tick) if tick > 100 else None
    stopped = physical.do(f"MOVE {ARM} BY 5 CM ALONG DOWN UNLESS TORQUE EXCEEDS 0.3 NM THEN STOP").reports[-1]
    assert stopped.reason is StopReason.TORQUE_LIMIT
    executor = physical.subsystem.executors[ARM]
    assert physical.world.value(f"{ARM}.joints") == pytest.approx(executor.sample.joints, abs=1e-3)

    physical.subsystem.disturb = lambda tick: twist(tick) if tick < 100 else None
    run = physical.do(f"MOVE {ARM} BY 2 CM ALONG UP")
    assert run.succeeded, (run.refusal, run.failure)


# --- the other arm is in doubt -------------------------------------------------------------------------------

CARRY = ("GRASP LEFT-END-EFF MACS-OLD HANDLE-B", "LIFT MACS-OLD BY 15 CM WITH LEFT-ARM")


@pytest.fixture
def lost(bench: Bench) -> Bench:
    """The MCM dies while the left arm carries a module."""
    for sentence in CARRY:
        assert bench.do(sentence).succeeded
    script = bench.elaborate("MOVE LEFT-ARM TO CLEAR-POINT-1")
    bound = bench.bind(script, script.steps[-1])
    name, arm = bound.primitive.id, bound.primitive.performer
    report = EndReport(primitive=name, performer=arm, reason=StopReason.SUBSYSTEM_LOST, at_s=0.0, duration_s=0.0)
    bench.world = bench.world.overlay(bench.analyze(bound, report, closing=True).changes)
    assert bench.world.get("LEFT-ARM.joints").validity != "valid"
    return bench


def test_an_arm_moves_while_the_other_one_holds_something_and_is_in_doubt(lost: Bench) -> None:
    for sentence in ("STOW RIGHT-ARM", "MOVE RIGHT-ARM BY 2 CM ALONG UP", "RETRACT RIGHT-ARM"):
        run = lost.do(sentence)
        assert run.succeeded, (sentence, run.refusal)


def test_the_way_out_of_an_arm_in_doubt_is_named_in_its_own_refusals(lost: Bench) -> None:
    lost.without_cameras()
    refusal = lost.do("STOW LEFT-ARM").refusal
    assert sentences_of(refusal.clears) == ["VERIFY MACS-OLD AT LEFT-ARM"]
    for sentence in ("VERIFY MACS-OLD AT LEFT-ARM", "STOW LEFT-ARM"):
        run = lost.do(sentence)
        assert run.succeeded, (sentence, run.refusal)


def test_the_joints_of_another_arm_are_read_with_the_figures_of_what_that_arm_holds(bench: Bench) -> None:
    for sentence in CARRY:
        assert bench.do(sentence).succeeded
    bench.set_fact("LEFT-ARM.joints", bench.world.value("LEFT-ARM.joints"), Validity.SUSPECT)
    made = bench.do("STOW RIGHT-ARM").primitives[0]
    assert made.performer == "LEFT-ARM"
    widths = [stop.when.limit_m for stop in made.stop_functions if isinstance(stop.when, HandWidthBelow)]
    assert widths == [pytest.approx(bench.world.value("LEFT-ARM.hand_width") - 0.006)]


# --- refusals that lead on -----------------------------------------------------------------------------------


def test_a_module_that_is_askew_in_the_hand_is_not_verified_again_but_looked_for(bench: Bench) -> None:
    for sentence in CARRY:
        assert bench.do(sentence).succeeded
    bench.subsystem.closes = [0.026]
    failure = bench.do("VERIFY MACS-OLD AT LEFT-ARM").failure
    assert failure.reason is StopReason.FORCE_LIMIT
    assert bench.subsystem.widths["LEFT-ARM"] == 0.026
    assert sentences_of(failure.clears) == ["LOCATE MACS-OLD"]
    for sentence in ("LOCATE MACS-OLD", "STOW LEFT-ARM"):
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.failure)


@pytest.mark.parametrize(("measured", "words"), [(45.3, "45.3 N where 45 N"), (45.02, "45.02 N where 45 N")])
def test_a_force_beyond_its_limit_reads_as_more_than_the_limit(bench: Bench, measured: float, words: str) -> None:
    script = bench.elaborate("STOW RIGHT-ARM")
    bound = bench.bind(script, script.steps[-1])
    report = bench.subsystem.perform(bound.primitive, bound)
    figures = {"reason": StopReason.FORCE_LIMIT, "measured": measured, "limit": 45.0}
    assert words in bench.analyze(bound, msgspec.structs.replace(report, **figures)).message  # wording: figures


@pytest.mark.physics
def test_an_arm_that_has_lost_what_it_is_believed_to_hold_backs_off(physical: Bench) -> None:
    """The grasp is in doubt, and the fingers press on nothing: that is no reason to stay."""
    for sentence in ("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", "LIFT MACS-NEW BY 15 CM"):
        assert physical.do(sentence).succeeded
    physical.set_fact("MACS-NEW.grasp", physical.world.value("MACS-NEW.grasp"), Validity.SUSPECT)
    sim = physical.subsystem.sim
    sim.world.place(sim.world.objects["MACS-NEW"], geometry.make_pose([0.8, -0.8, 1.6]))
    run = physical.do(f"RETRACT {ARM}")
    assert run.succeeded, (run.refusal, run.failure)

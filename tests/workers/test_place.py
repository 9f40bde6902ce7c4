"""PLACE succeeds when the seat has the thing, and only then; otherwise its advice leads to a PLACE that does."""

from __future__ import annotations

import msgspec
import pytest

from rtc.protocol.messages import Validity
from rtc.protocol.outcomes import Refusal, StopReason
from rtc.robot import geometry
from workers.planning.robot_models import CellModel

from .conftest import CELL

GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"
LIFT = "LIFT MACS-NEW BY 15 CM"


def lifted(bench):
    for sentence in (GRASP, LIFT):
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.assessments)
    return bench


@pytest.mark.parametrize("seat", ["RACK-1", "BAY-2"])
def test_straight_from_the_lift_into_either_seat(either, seat):
    """Where the straight part of the way begins follows from the depth of the seat."""
    run = lifted(either).do(f"PLACE MACS-NEW ON {seat}")

    assert run.succeeded, (run.refusal, run.assessments)
    assert run.reasons[2:4] == ["contact", "contact"]  # set down, and tugged at
    assert either.world.value("MACS-NEW.seat") == seat
    assert either.world.get("MACS-NEW.frame").validity is Validity.VALID


def test_what_touches_nothing_is_not_in_its_seat(bench):
    lifted(bench)
    bench.subsystem.seats = False

    run = bench.do("PLACE MACS-NEW ON BAY-2")

    assert run.labels[-1] == "set MACS-NEW down in BAY-2"
    last = run.assessments[-1]
    assert (last.verdict, last.reason) == ("abort", StopReason.NO_CONTACT)
    assert bench.world.value("RIGHT-ARM.holding") == "MACS-NEW"
    assert bench.world.get("MACS-NEW.frame").validity is Validity.SUSPECT
    assert "SET MACS-NEW FRAME" in last.clears
    assert "VERIFY" not in last.clears  # fingers feel nothing of what is wrong


def test_what_gives_way_to_a_tug_is_not_let_go(bench):
    lifted(bench)
    script = bench.elaborate("PLACE MACS-NEW ON BAY-2")
    tug = next(n for n, step in enumerate(script.steps) if step.stop == "tug")
    for step in script.steps[:tug]:
        bound = bench.bind(script, step)
        bench.world = bench.world.overlay(bench.analyze(bound, bench.subsystem.perform(bound.primitive, bound)).changes)
    bound = bench.bind(script, script.steps[tug])
    bench.subsystem.seats = False

    made = bench.analyze(bound, bench.subsystem.perform(bound.primitive, bound))

    assert (made.verdict, made.reason) == ("abort", StopReason.NO_CONTACT)
    assert "gave way to a light tug" in made.message
    limits = [s.when.limit_n for s in bound.primitive.stop_functions if s.reason is StopReason.CONTACT]
    assert limits == [0.25 * CELL.seat("BAY-2").detent_n]
    assert (
        geometry.distance(bound.evaluation.goal_pose, bench.model.arms["RIGHT-ARM"].fk(bound.evaluation.start_joints))
        < 0.004
    )


def test_a_seat_without_a_catch_needs_no_tug(bench):
    seats = [msgspec.structs.replace(seat, detent_n=0.0) for seat in CELL.seats]
    model = CellModel(msgspec.structs.replace(CELL, seats=seats))
    lifted(bench)

    script = bench.elaborate("PLACE MACS-NEW ON BAY-2", model)

    assert script.context.script == "place-without-catch"
    assert "tug" not in [step.stop for step in script.steps]


def test_after_a_place_that_failed_the_advice_leads_to_one_that_does_not(bench):
    """The module was 23 mm nearer to the hand than believed, so it ended 23 mm short of its seat."""
    lifted(bench)
    bench.subsystem.seats = False
    failed = bench.do("PLACE MACS-NEW ON BAY-2")
    believed = bench.world.value("MACS-NEW.frame")
    bench.subsystem.seats = True
    x, y, z = (100 * n for n in believed[:3])

    refusal = bench.do("LIFT MACS-NEW BY 30 CM").refusal
    assert isinstance(refusal, Refusal)  # in doubt as it is
    for sentence in (
        f"SET MACS-NEW FRAME {x - 2.3:.2f} {y:.2f} {z:.2f} CM 0 0 0 DEG",
        "LIFT MACS-NEW BY 30 CM",
        "PLACE MACS-NEW ON BAY-2",
    ):
        assert sentence.split()[0] in failed.assessments[-1].clears
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.assessments)


def true_pose(bench):
    return bench.subsystem.sim.truth()["poses"]["MACS-NEW"]


@pytest.mark.slow
def test_on_physics_a_module_short_of_its_seat_is_not_placed_until_its_pose_is_stated(physical):
    physical.subsystem.displace("MACS-NEW", [-0.023, 0.0, 0.0])
    failed = lifted(physical).do("PLACE MACS-NEW ON BAY-2")

    assert not failed.succeeded
    assert physical.world.value("RIGHT-ARM.holding") == "MACS-NEW"
    assert physical.world.get("MACS-NEW.frame").validity is Validity.SUSPECT

    x, y, z = (100 * n for n in true_pose(physical)[:3])
    for sentence in (
        f"SET MACS-NEW FRAME {x:.2f} {y:.2f} {z:.2f} CM 0 0 0 DEG",
        "LIFT MACS-NEW BY 30 CM",
        "PLACE MACS-NEW ON BAY-2",
    ):
        run = physical.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.assessments)
    assert geometry.distance(true_pose(physical), CELL.seated_pose("BAY-2")) < 0.004
    assert "MACS-NEW" in physical.subsystem.sim._detents._caught


@pytest.mark.slow
def test_on_physics_what_no_catch_holds_is_not_let_go(physical):
    lifted(physical)
    physical.subsystem.sim._detents._seats = []  # the catches are broken

    run = physical.do("PLACE MACS-NEW ON RACK-1")

    assert run.labels[-1].startswith("tug at MACS-NEW")
    assert not run.succeeded
    assert physical.world.value("RIGHT-ARM.holding") == "MACS-NEW"

"""PLACE succeeds when the seat has the thing, and only then; otherwise its advice leads to a PLACE that does."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from rtc.protocol.messages import Limits, Validity, WorldChange
from rtc.protocol.outcomes import Refusal, StopReason
from rtc.protocol.primitive import ForceAbove, TorqueAbove
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line
from rtc.world.spread import even
from tests.workers.conftest import CELL, MODEL
from workers.planning import scenes
from workers.planning.motion.request import free_posture
from workers.planning.motion.timing import SpeedLimits
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery

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


@pytest.mark.parametrize(
    ("arm", "thing", "rack"), [("RIGHT-ARM", "MACS-NEW", "RACK-1"), ("LEFT-ARM", "MACS-OLD", "RACK-2")]
)
@pytest.mark.parametrize("handle", ["HANDLE-A", "HANDLE-B"])
def test_from_anywhere_with_either_handle(bench, arm, thing, rack, handle):
    """From free postures all over the reach, wherever a halt may have left the arm."""
    for sentence in (f"GRASP {arm.replace('ARM', 'END-EFF')} {thing} {handle}", f"LIFT {thing} BY 15 CM"):
        assert bench.do(sentence).succeeded
    held, random = bench.world, np.random.default_rng(11)
    query = WorldQuery(MODEL, held)
    request = scenes.planning_request(query, arm, scenes.scene_of(query, arm, Limits()), Limits(), SpeedLimits(), 0.06)
    lower, upper = request.arm.limits.lower + 0.06, request.arm.limits.upper - 0.06
    postures = (random.uniform(lower, upper) for _ in range(10_000))
    free = [q for q in postures if free_posture(request)(q) is None][:3]
    for q in free:
        for seat in (rack, "BAY-2"):
            bench.world = held
            bench.set_fact(f"{arm}.joints", q.tolist())
            bench.subsystem.joints[arm] = q.copy()
            run = bench.do(f"PLACE {thing} ON {seat}")
            assert run.succeeded, (seat, q, run.refusal)
            bench.subsystem.widths[arm] = 0.02


@pytest.mark.physics
def test_on_physics_ways_found_by_sampling_are_followed(physical):
    """Beside the satellite no direct way is free; and with an attitude kept. Before the LIFT nothing else moves."""
    ways = []
    assert physical.do(GRASP).succeeded
    seated = physical.do("STOW RIGHT-ARM")
    assert not seated.primitives
    for sentence in (
        seated.refusal.clears[0].sentences[0],
        "LIFT MACS-NEW BY 5 CM",
        "MOVE RIGHT-ARM TO POSITION 57 -62 52 CM",
        "MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN POSE-DURING-MOTION LEVEL",
        "PLACE MACS-NEW ON BAY-2",
    ):
        run = physical.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.assessments)
        ways += [step.way for step in run.script.steps if step.to and step.way is not None]
    assert physical.world.value("MACS-NEW.seat") == "BAY-2"
    assert sum("samples of seed" in way.notes[-1] for way in ways) >= 1


def test_what_touches_nothing_is_not_in_its_seat(bench):
    bench.without_cameras()
    lifted(bench)
    bench.subsystem.seats = False

    run = bench.do("PLACE MACS-NEW ON BAY-2")

    assert run.labels[-1] == "set MACS-NEW down in BAY-2"
    last = run.assessments[-1]
    assert (last.verdict, last.reason) == ("abort", StopReason.NO_CONTACT)
    assert bench.world.value("RIGHT-ARM.holding") == "MACS-NEW"
    assert bench.world.get("MACS-NEW.frame").validity is Validity.SUSPECT
    assert "SET MACS-NEW FRAME" in in_one_line(last.clears)
    assert "VERIFY" not in in_one_line(last.clears)  # fingers feel nothing of what is wrong


def test_what_gives_way_to_a_tug_is_not_let_go(bench):
    lifted(bench)
    script = bench.elaborate("PLACE MACS-NEW ON BAY-2")
    tug = next(n for n, step in enumerate(script.steps) if step.stop == "tug")
    for step in script.steps[:tug]:
        bound = bench.bind(script, step)
        bench.world = bench.world.overlay(bench.analyze(bound, bench.subsystem.perform(bound.primitive, bound)).changes)
    bound = bench.bind(script, script.steps[tug])
    bench.subsystem.seats = False
    catch_n = CELL.seat("BAY-2").detent_n

    made = bench.analyze(bound, bench.subsystem.perform(bound.primitive, bound))

    assert (made.verdict, made.reason) == ("abort", StopReason.NO_CONTACT)
    felt = [s.when for s in bound.primitive.stop_functions if s.reason is StopReason.CONTACT]
    assert felt == [ForceAbove(limit_n=0.28 * catch_n), TorqueAbove(limit_nm=0.037 * catch_n)]
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
    bench.without_cameras()
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
        "SET BAY-2 FRAME 93 0 70 CM 0 0 0 DEG",
        "LIFT MACS-NEW BY 30 CM",
        "PLACE MACS-NEW ON BAY-2",
    ):
        verb, thing, *_ = sentence.split()
        assert f"{verb} {thing}" in in_one_line(failed.assessments[-1].clears) or verb == "PLACE"
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.assessments)


@pytest.mark.physics
def test_on_physics_a_module_short_of_its_seat_is_not_placed(physical):
    """What helps then: `test_after_a_place_that_failed_the_advice_leads_to_one_that_does_not`."""
    physical.subsystem.displace("MACS-NEW", [-0.023, 0.0, 0.0])
    failed = lifted(physical).do("PLACE MACS-NEW ON BAY-2")

    assert not failed.succeeded
    assert physical.world.value("RIGHT-ARM.holding") == "MACS-NEW"
    assert physical.world.get("MACS-NEW.frame").validity is Validity.SUSPECT


@pytest.mark.physics
def test_on_physics_what_no_catch_holds_is_not_let_go(physical):
    lifted(physical)
    physical.subsystem.sim._detents._seats = []  # the catches are broken

    run = physical.do("PLACE MACS-NEW ON RACK-1")

    assert run.labels[-1].startswith("tug at MACS-NEW")
    assert not run.succeeded
    assert physical.world.value("RIGHT-ARM.holding") == "MACS-NEW"


@pytest.mark.physics
def test_on_physics_a_bay_that_is_14_mm_off_is_named_and_the_advice_leads_in(physical):
    """The cameras know the bay within 8 mm only, and the module hides it while it is before the bay."""
    bay = physical.subsystem.sim.world.seats["BAY-2"]
    bay.home = geometry.translate(bay.home, [0.0, 0.014, 0.0])
    physical.subsystem.sim.world.place(bay, bay.home)
    lifted(physical)
    x, y, z = (100 * n for n in bay.home[:3])

    failed = physical.do("PLACE MACS-NEW ON BAY-2")

    first, *others = failed.assessments[-1].clears
    assert (first.sentences[-1], first.states[-1]) == ("LIFT MACS-NEW BY 30 CM", "BAY-2.frame")
    assert any(one.sentences[-2:] == ["LIFT MACS-NEW BY 30 CM", "LOCATE BAY-2"] for one in others)
    assert physical.world.get("BAY-2.frame").validity is Validity.SUSPECT
    stated = f"SET BAY-2 FRAME {x:.1f} {y:.1f} {z:.1f} CM 0 0 0 DEG"
    for sentence in (stated, "LIFT MACS-NEW BY 30 CM", "PLACE MACS-NEW ON BAY-2"):
        run = physical.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.failure)
    assert physical.world.value("MACS-NEW.seat") == "BAY-2"
    assert "MACS-NEW" in physical.subsystem.sim._detents._caught


def test_after_a_place_that_failed_in_a_bay_that_was_located_the_cameras_are_not_advised_again(bench):
    lifted(bench)
    bench.subsystem.seats = False
    located = ["LIFT MACS-NEW BY 30 CM", "LOCATE BAY-2"]
    failed = bench.do("PLACE MACS-NEW ON BAY-2")
    assert any(one.sentences[-2:] == located for one in failed.assessments[-1].clears)
    for sentence in ("LIFT MACS-NEW BY 30 CM", "STOW RIGHT-ARM", "LOCATE BAY-2"):
        assert bench.do(sentence).succeeded, sentence
    again = bench.do("PLACE MACS-NEW ON BAY-2")
    assert not again.succeeded
    assert "LOCATE BAY-2" not in in_one_line(again.assessments[-1].clears)  # the cameras know no better


# --- a seat that is tilted -------------------------------------------------------------------------------------

TILTED = [0.0, math.radians(4.0), 0.0]
STATED = even(0.005, 0.035)  # of a pose that a SET has stated


def tilt(bench, seat, thing):
    """The seat stands tilted, with its module, and both are believed where they are."""
    frame = geometry.make_pose(bench.model.cell.seat(seat).frame.pose[:3])
    frame = geometry.compose(frame, geometry.from_rpy([0.0, 0.0, 0.0], TILTED))
    frame = geometry.compose(frame, geometry.make_pose([0.0, 0.0, 0.0], bench.model.cell.seat(seat).frame.pose[3:]))
    bench.set_fact(f"{seat}.frame", frame.tolist())
    if thing:
        inside = geometry.compose(frame, bench.model.cell.seat(seat).module_frame.pose)
        bench.set_fact(f"{thing}.frame", inside.tolist())
        bench.subsystem.poses[thing] = inside
    return frame


def test_lift_takes_a_module_out_along_the_walls_of_its_tilted_seat(bench):
    frame = tilt(bench, "RACK-1", "MACS-NEW")
    assert bench.do(GRASP).succeeded
    before = np.array(bench.world.value("MACS-NEW.frame")[:3])
    assert bench.do(LIFT).succeeded
    way = np.array(bench.world.value("MACS-NEW.frame")[:3]) - before
    out = geometry.rotate(frame, CELL.seat("RACK-1").way_out)
    assert np.linalg.norm(way - 0.15 * out) < 0.001
    assert abs(way[0]) > 0.009  # straight up would press on a wall


def test_a_module_whose_pose_was_stated_goes_from_afar_into_the_tilted_bay(bench):
    """Before the mouth of the bay it keeps as much distance as it is uncertain, and comes near in a line."""
    bench.without_cameras()
    lifted(bench)
    assert bench.do("MOVE RIGHT-ARM TO POSITION 40 -20 95 CM").succeeded
    tilt(bench, "BAY-2", "")
    for name in ("frame", "grasp"):
        fact = bench.world.get(f"MACS-NEW.{name}")
        bench.world = bench.world.overlay([WorldChange(key=fact.key, value=fact.value, spread=STATED)])
    made = bench.elaborate("PLACE MACS-NEW ON BAY-2")
    assert not isinstance(made, Refusal), made


def test_a_module_whose_way_out_is_blocked_is_not_sent_the_same_way_again(bench):
    assert bench.do(GRASP).succeeded
    above = geometry.translate(bench.world.value("MACS-NEW.frame"), [-0.25, 0.20, 0.15])
    bench.set_fact("MACS-OLD.frame", above.tolist())
    bench.set_fact("MACS-OLD.seat", "")
    refusal = bench.do("LIFT MACS-NEW BY 15 CM").refusal
    assert refusal.clears[0].sentences == ["RELEASE MACS-NEW"]
    assert bench.do("RELEASE MACS-NEW").succeeded  # the hand backs off without it

"""Arm, hand and held module keep their distance on every way; a refusal states how much room there is."""

from __future__ import annotations

import itertools

import pybullet
import pytest

from rtc.protocol.advice import sentences_of
from rtc.protocol.messages import WorldChange
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.wording.advice import in_one_line
from rtc.world.spread import even
from tests.campaigns import laden_ways

ARM, MODULE = "LEFT-ARM", "MACS-OLD"
TAKEN = (f"GRASP LEFT-END-EFF {MODULE} HANDLE-B", f"LIFT {MODULE} BY 15 CM WITH {ARM}")


@pytest.mark.physics
def test_four_plain_sentences_bring_the_module_into_the_bay_without_a_touch_before(physical):
    """Nothing is displaced. The module was 1 mm from the satellite on its way, and its place is known to 3 mm."""
    physical.unsurveyed()
    for sentence in (*TAKEN, f"MOVE {ARM} TO CLEAR-POINT-1"):
        run = physical.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.assessments)
    world, touched = physical.subsystem.sim.world, set()
    others = {body: name for body, name in world.names.items() if name.split()[0] in ("SATELLITE", "RACK-2")}

    def watch(tick):
        for body, name in others.items() if tick % 5 == 0 else ():
            near = pybullet.getClosestPoints(world.objects[MODULE].id, body, 0.004, physicsClientId=world.client)
            touched.update((name, round(1e3 * point[8], 1)) for point in near)

    physical.subsystem.disturb = watch
    run = physical.do("PLACE MACS-OLD ON BAY-2")
    assert run.succeeded, (run.refusal, run.assessments)
    assert not touched  # nearer than 4 mm in truth
    assert physical.world.value(f"{MODULE}.seat") == "BAY-2"


def test_every_laden_way_keeps_five_millimetres():
    """The campaign `laden_ways`, in short."""
    for case in itertools.islice(laden_ways.shuffled(laden_ways.SEED), 12):
        way = laden_ways.run(case)
        assert not laden_ways.too_near(way), (case, way)
        assert way.end != "same advice", way.story


def known_within(bench, key, spread):
    bench.world = bench.world.overlay([WorldChange(key=key, keep_value=True, spread=spread)])


def test_a_held_object_keeps_as_much_distance_as_its_place_is_uncertain_and_a_look_makes_room(bench):
    for sentence in TAKEN:
        assert bench.do(sentence).succeeded
    known_within(bench, f"{MODULE}.grasp", even(0.012, 0.02))
    sentence = f"MOVE {ARM} TO CLEAR-POINT-1"  # 20 mm before the satellite

    run = bench.do(sentence)

    assert run.succeeded, (run.refusal, run.assessments)
    assert run.labels[0].startswith(f"look for {MODULE}")


def test_without_cameras_a_held_object_of_an_uncertain_place_is_not_taken_so_near(bench):
    for sentence in TAKEN:
        assert bench.do(sentence).succeeded
    known_within(bench, f"{MODULE}.grasp", even(0.012, 0.02))
    bench.without_cameras()

    refusal = bench.do(f"MOVE {ARM} TO CLEAR-POINT-1").refusal

    assert refusal.reason is RefusalReason.INFEASIBLE
    assert 0.015 < refusal.cause.distance_m < refusal.cause.margin_m
    assert {refusal.cause.body_a.split()[0], refusal.cause.body_b.split()[0]} == {MODULE, "SATELLITE"}


def test_near_an_object_whose_place_is_not_known_well_the_refusal_says_so(bench):
    bench.unsurveyed()
    sentence = "MOVE RIGHT-ARM TO POSITION 60 -80 60 CM"  # 3 cm before the handles

    refusal = bench.do(sentence).refusal

    assert 0.005 < refusal.cause.distance_m < refusal.cause.margin_m
    assert refusal.clears[0].sentences == ["LOCATE MACS-NEW"]
    for advised in ("LOCATE MACS-NEW", sentence):
        run = bench.do(advised)
        assert run.succeeded, (advised, run.refusal, run.assessments)


def test_without_room_for_the_clearance_a_look_is_not_advised(bench):
    bench.unsurveyed()
    refusal = bench.elaborate("MOVE RIGHT-ARM TO POSITION 68.3 -80 60 CM")
    assert isinstance(refusal, Refusal)
    assert "LOCATE" not in in_one_line(refusal.clears)


def test_where_no_look_makes_enough_room_another_place_is_named_before_the_arm_moves(bench):
    """The module is in the rack: what is near then is not near when it has left. A look at the rack knows its pose
    within 27 mm, and it is known within 21 mm."""
    assert bench.do("GRASP MACS-NEW WITH RIGHT-ARM").succeeded
    rack = bench.model.cell.seat("RACK-1").frame.pose
    bench.world = bench.world.overlay([WorldChange(key="RACK-1.frame", value=[*rack], spread=even(0.012, 0.0))])

    run = bench.do("CARRY MACS-NEW TO RACK-1-FRONT")

    assert run.refusal is not None
    assert run.primitives == []
    first = run.refusal.clears[0]
    assert first.instead
    assert "LOCATE RACK-1" not in sentences_of(run.refusal.clears)
    for sentence in first.sentences:
        assert bench.do(sentence).succeeded

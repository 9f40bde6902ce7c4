"""A held module that is still in its seat leaves it straight, with one arm and with two."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from rtc.protocol.advice import sentences_of
from rtc.protocol.causes import InSeat
from rtc.protocol.messages import Limits
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.spatial import geometry
from tests.workers.conftest import CELL, MODEL, Bench
from workers.planning import scenes
from workers.planning.motion.plan import before_contact
from workers.planning.motion.timing import SpeedLimits
from workers.planning.world_query import WorldQuery

RIGHT, LEFT, MODULE = "RIGHT-ARM", "LEFT-ARM", "MACS-NEW"


@pytest.fixture
def both_in_the_bay(bench: Bench) -> Bench:
    """Both hands hold a module in the bay."""
    module = CELL.seated_pose("BAY-2")
    hands = {}
    for arm, name in ((RIGHT, "HANDLE-A"), (LEFT, "HANDLE-B")):
        hands[arm] = geometry.compose(module, CELL.object(MODULE).grasp_point(name).frame.pose)
        joints = MODEL.arms[arm].ik(hands[arm].tolist(), CELL.arm(arm).home_rad, 0.06)[0]
        bench.subsystem.joints[arm] = np.array(joints)
        bench.subsystem.widths[arm] = 0.02
        bench.set_fact(f"{arm}.joints", joints.tolist())
        bench.set_fact(f"{arm}.hand_width", 0.02)
        bench.set_fact(f"{arm}.holding", MODULE)
    bench.set_fact(f"{MODULE}.held_by", RIGHT)
    bench.set_fact(f"{MODULE}.grasp", geometry.normalise(geometry.relative(hands[RIGHT], module)).tolist())
    bench.set_fact(f"{MODULE}.frame", geometry.normalise(module).tolist())
    bench.set_fact(f"{MODULE}.seat", "BAY-2")
    bench.subsystem.poses[MODULE] = module
    return bench


@pytest.mark.parametrize("sentence", ["MOVE BOTH-ARMS BY 5 CM ALONG LEFT", "MOVE BOTH-ARMS TO POSITION 48 -8 80 CM"])
def test_two_arms_draw_a_module_out_before_they_move_it_elsewhere(both_in_the_bay, sentence):
    refused = both_in_the_bay.elaborate(sentence)

    assert isinstance(refused, Refusal)
    assert refused.reason is RefusalReason.STATE
    (advised,) = sentences_of(refused.clears)
    assert advised == "MOVE BOTH-ARMS BY 25 CM ALONG BACK"
    assert both_in_the_bay.do(advised).succeeded
    assert getattr(both_in_the_bay.elaborate(sentence), "where", "") != MODULE  # another reason, if any


def test_two_arms_do_not_press_a_module_deeper_into_its_seat(both_in_the_bay):
    refused = both_in_the_bay.elaborate("MOVE BOTH-ARMS BY -5 CM ALONG BACK")

    assert isinstance(refused, Refusal)
    assert refused.cause == InSeat(arm="RIGHT-ARM", seat="BAY-2")


def test_two_arms_do_not_turn_a_module_in_its_seat(both_in_the_bay):
    script = both_in_the_bay.elaborate("MOVE BOTH-ARMS BY 5 CM ALONG BACK")
    step = script.steps[0]
    step = msgspec.structs.replace(step, by_rad=0.1)

    refused = both_in_the_bay.bind(script, step)

    assert isinstance(refused, Refusal)
    assert refused.cause == InSeat(arm="RIGHT-ARM", seat="BAY-2")


def test_the_binder_refuses_what_has_been_elaborated_before_the_grasp(bench):
    script = bench.elaborate("STOW RIGHT-ARM")
    assert bench.do(f"GRASP RIGHT-END-EFF {MODULE} HANDLE-A").succeeded

    refused = bench.bind(script, script.steps[0])

    assert sentences_of(refused.clears) == [f"LIFT {MODULE} BY 15 CM WITH {RIGHT}"]


def test_a_module_is_not_lifted_into_the_floor_of_its_rack(bench):
    assert bench.do(f"GRASP RIGHT-END-EFF {MODULE} HANDLE-A").succeeded

    for sentence in (f"LIFT {MODULE} BY -5 CM", f"LIFT {MODULE} BY -1 MM"):
        refused = bench.elaborate(sentence)
        assert isinstance(refused, Refusal), sentence
        assert refused.cause == InSeat(arm=RIGHT, seat="RACK-1")

    assert bench.do(f"LIFT {MODULE} BY 5 CM").succeeded
    assert isinstance(bench.elaborate(f"LIFT {MODULE} BY -6 CM"), Refusal)
    assert bench.do(f"LIFT {MODULE} BY -4 CM").succeeded  # still in the slot


@pytest.mark.parametrize(("by_cm", "left_cm"), [(5, 10), (11, 4)])
def test_the_advice_counts_how_far_it_is_out_already(bench, by_cm, left_cm):
    for sentence in (f"GRASP RIGHT-END-EFF {MODULE} HANDLE-B", f"LIFT {MODULE} BY {by_cm} CM"):
        assert bench.do(sentence).succeeded

    refused = bench.elaborate("MOVE RIGHT-ARM TO BAY-2-FRONT")

    assert refused.clears[0].sentences == [f"LIFT {MODULE} BY {left_cm} CM WITH {RIGHT}"]
    assert bench.do(refused.clears[0].sentences[0]).succeeded
    assert bench.do("MOVE RIGHT-ARM TO BAY-2-FRONT").succeeded


def test_a_carry_keeps_clear_of_the_seat_that_it_leads_to(bench):
    """The straight part of PLACE enters the seat; before it, the walls are obstacles like others."""
    for sentence in (f"GRASP RIGHT-END-EFF {MODULE} HANDLE-A", f"LIFT {MODULE} BY 15 CM"):
        assert bench.do(sentence).succeeded
    query = WorldQuery(MODEL, bench.world)
    scene = scenes.scene_of(query, RIGHT, Limits(), exempt=[MODULE, "RACK-1"])
    request = scenes.planning_request(query, RIGHT, scene, Limits(), SpeedLimits(), 0.06)

    assert "RACK-1" in scene.near
    assert MODULE not in scene.near  # it keeps its distance from all other bodies, on the straight part too
    assert "RACK-1" not in before_contact(request, request.start).scene.near

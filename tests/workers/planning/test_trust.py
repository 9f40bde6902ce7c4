"""A step that needs to know more of what the hand holds than is known is refused, with what would tell it."""

from __future__ import annotations

import msgspec
import pytest

from rtc.protocol import causes
from rtc.protocol.messages import WorldChange
from rtc.protocol.outcomes import Refusal, RefusalReason, StopReason
from rtc.wording.advice import in_one_line
from rtc.world.spread import even
from workers.planning import trust

GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"
PLACE = "PLACE MACS-NEW ON RACK-1"


@pytest.fixture
def holding(bench):
    bench.without_cameras()
    for sentence in (GRASP, "LIFT MACS-NEW BY 15 CM"):
        assert bench.do(sentence).succeeded
    return bench


def known_within(bench, spread):
    changes = [WorldChange(key="MACS-NEW.grasp", keep_value=True, spread=spread)]
    bench.world = bench.world.overlay(changes)


@pytest.mark.parametrize(
    ("sentence", "most_m"), [("PLACE MACS-NEW ON RACK-1", 0.010), ("MOVE RIGHT-ARM TO POSITION 40 -60 95 CM", 0.030)]
)
def test_what_is_held_must_be_known_as_well_as_the_step_needs(holding, sentence, most_m):
    known_within(holding, even(most_m - 0.001, 0.01))
    assert not isinstance(holding.elaborate(sentence), Refusal)

    known_within(holding, [0.001, 0.001, most_m + 0.001, 0.01, 0.01, 0.01])
    refused = holding.elaborate(sentence)

    assert refused.reason is RefusalReason.SUSPECT
    assert refused.cause == causes.TooUncertain(fact="MACS-NEW.grasp")
    assert "SET MACS-NEW FRAME" in in_one_line(refused.clears)
    assert "release" not in in_one_line(refused.clears).lower()  # RELEASE refers to PLACE


def test_what_has_crept_meanwhile_is_found_out_when_the_step_is_bound(holding):
    script = holding.elaborate("PLACE MACS-NEW ON RACK-1")
    known_within(holding, even(0.011, 0.01))

    refused = holding.bind(script, script.steps[1])

    assert refused.reason is RefusalReason.SUSPECT
    assert refused.where == "MACS-NEW.grasp"


def test_an_hour_of_rest_makes_nothing_less_certain(holding):
    """How long people think, workers plan or a core is busy changes nothing of what happens then."""
    holding.now_s = 100.0
    assert holding.do("MOVE RIGHT-ARM BY 2 CM ALONG Z").succeeded
    soon = holding.elaborate(PLACE)

    holding.now_s = 3700.0
    later = holding.elaborate(PLACE)

    assert later.steps == soon.steps
    assert holding.do("MOVE RIGHT-ARM BY 2 CM ALONG Z").succeeded
    known_m = holding.world.get("MACS-NEW.grasp").spread[0]
    holding.now_s = 3800.0
    assert holding.do("MOVE RIGHT-ARM BY -2 CM ALONG Z").succeeded
    moved_s = sum(report.duration_s for report in holding.do("MOVE RIGHT-ARM BY 2 CM ALONG Z").reports)
    more_m = holding.world.get("MACS-NEW.grasp").spread[0] - known_m
    assert more_m == pytest.approx(2 * moved_s * holding.model.cell.numbers.creep_m_s, rel=0.1)


def test_an_accepted_place_has_the_motion_to_carry_the_object(holding):
    """The object is known well enough now, but not when it has been carried to the seat."""
    creep_m = trust.AHEAD_S * holding.model.cell.numbers.creep_m_s
    known_within(holding, even(0.010 - 0.9 * creep_m, 0.01))
    assert holding.elaborate(PLACE).reason is RefusalReason.SUSPECT

    known_within(holding, even(0.010 - 1.1 * creep_m, 0.01))
    script = holding.elaborate(PLACE)
    known_within(holding, even(0.0099, 0.01))  # after the first step
    assert not isinstance(holding.bind(script, script.steps[1]), Refusal)


def test_a_slow_carry_takes_more_of_the_motion(holding):
    known_within(holding, even(0.010 - 2.0 * trust.AHEAD_S * holding.model.cell.numbers.creep_m_s, 0.01))
    assert not isinstance(holding.elaborate(PLACE), Refusal)
    assert holding.elaborate(f"{PLACE} MAINTAIN SPEED 5 CM/S").reason is RefusalReason.SUSPECT


def test_the_advice_for_an_uncertain_object_leads_to_its_seat(holding):
    """RELEASE refers to PLACE, so PLACE must refer to a sentence that succeeds."""
    known_within(holding, even(0.021, 0.01))
    assert "PLACE MACS-NEW" in in_one_line(holding.do("RELEASE MACS-NEW").refusal.clears)
    advice = holding.do(PLACE).refusal.clears

    x, y, z = (100 * n for n in holding.world.value("MACS-NEW.frame")[:3])
    assert any(one.states == ["MACS-NEW.frame"] for one in advice)
    assert holding.do(f"SET MACS-NEW FRAME {x:.2f} {y:.2f} {z:.2f} CM 0 0 0 DEG").succeeded
    assert holding.do(PLACE).succeeded


def test_an_empty_hand_needs_to_know_nothing(bench):
    bench.unsurveyed()
    assert not isinstance(bench.elaborate("MOVE RIGHT-ARM TO CLEAR-POINT-1"), Refusal)


def test_a_grasp_that_feels_one_axis_is_refused_if_the_pose_is_too_uncertain_for_it(bench):
    """Figure 4 alone feels one axis; the advice clears it."""
    bench.without_cameras()
    bench.load("elaborator", "decision_tree: [{verb: GRASP, script: grasp-feeling, enabled: false}]")
    bench.unsurveyed()
    refused = bench.elaborate(GRASP)
    assert refused.reason is RefusalReason.SUSPECT
    assert refused.cause == causes.TooUncertain(fact="MACS-NEW.frame")
    assert "SET MACS-NEW FRAME x y z CM roll pitch yaw DEG" in in_one_line(refused.clears)
    assert bench.do("SET MACS-NEW FRAME 80 -80 60 CM 0 0 0 DEG").succeeded
    assert bench.do(GRASP).succeeded


@pytest.mark.parametrize("reason", [StopReason.FORCE_LIMIT, StopReason.CONTACT])
def test_a_module_that_jams_on_its_way_in_is_drawn_out_by_the_advice(holding, reason):
    """STOW and MOVE are refused from inside a seat."""
    script = holding.elaborate("PLACE MACS-NEW ON RACK-1")
    bound = holding.bind(script, script.steps[1])
    report = holding.subsystem.perform(bound.primitive, bound)
    made = holding.analyze(bound, msgspec.structs.replace(report, reason=reason, measured=30.1, limit=30.0))
    assert made.verdict == "abort"
    first = made.clears[0]
    out = first.sentences.index("LIFT MACS-NEW BY 30 CM")
    assert not any("RACK-1" in sentence for sentence in first.sentences[:out])  # the module hides it from the cameras
    assert any("RACK-1" in about for about in (*first.sentences[out:], *first.states))
    assert first.again


def test_what_no_camera_sees_in_the_hand_is_brought_before_one(bench):
    """Its pose is too uncertain for a seat; each sentence of the advice works, and then the seat is reached."""
    for sentence in (GRASP, "LIFT MACS-NEW BY 15 CM", "STOW RIGHT-ARM"):
        assert bench.do(sentence).succeeded
    known_within(bench, even(0.012, 0.02))

    brought, stated = bench.elaborate(PLACE).clears

    assert brought.sentences == ["MOVE RIGHT-ARM TO BAY-2-FRONT", "LOCATE MACS-NEW"]
    assert stated.states == ["MACS-NEW.frame"]
    for sentence in (*brought.sentences, PLACE):
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal)

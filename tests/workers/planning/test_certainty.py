"""A step that needs to know more of what the hand holds than is known is refused, with what would tell it."""

from __future__ import annotations

import msgspec
import pytest

from rtc.protocol.messages import WorldChange
from rtc.protocol.outcomes import Refusal, RefusalReason, StopReason
from rtc.world.spread import even

GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"


@pytest.fixture
def holding(bench):
    for sentence in (GRASP, "LIFT MACS-NEW BY 15 CM"):
        assert bench.do(sentence).succeeded
    return bench


def known_within(bench, spread):
    bench.world = bench.world.overlay([WorldChange(key="MACS-NEW.grasp", keep_value=True, spread=spread)])


@pytest.mark.parametrize(
    ("sentence", "most_m"), [("PLACE MACS-NEW ON RACK-1", 0.010), ("MOVE RIGHT-ARM TO CLEAR-POINT-1", 0.030)]
)
def test_what_is_held_must_be_known_as_well_as_the_step_needs(holding, sentence, most_m):
    known_within(holding, even(most_m - 0.001, 0.01))
    assert not isinstance(holding.elaborate(sentence), Refusal)

    known_within(holding, [0.001, 0.001, most_m + 0.001, 0.01, 0.01, 0.01])
    refused = holding.elaborate(sentence)

    assert refused.reason is RefusalReason.SUSPECT
    assert f"z {1e3 * most_m + 1:.3g} mm ({1e3 * most_m:.3g} mm needed)" in refused.message
    assert "GRASP it again" in refused.clears


def test_what_has_crept_meanwhile_is_found_out_when_the_step_is_bound(holding):
    script = holding.elaborate("PLACE MACS-NEW ON RACK-1")
    known_within(holding, even(0.011, 0.01))

    refused = holding.bind(script, script.steps[1])

    assert refused.reason is RefusalReason.SUSPECT
    assert refused.where == "MACS-NEW.grasp"


def test_an_empty_hand_needs_to_know_nothing(bench):
    bench.unsurveyed()
    assert not isinstance(bench.elaborate("MOVE RIGHT-ARM TO CLEAR-POINT-1"), Refusal)


def test_what_a_grasp_could_not_feel_is_too_little_for_a_seat(bench):
    """Figure 4 alone feels one axis; in the cell as it comes that is refused before anything moves."""
    bench.load("elaborator", "decision_tree: [{verb: GRASP, script: grasp-feeling, enabled: false}]")
    bench.unsurveyed()
    assert bench.do(GRASP).succeeded
    refused = bench.elaborate("PLACE MACS-NEW ON RACK-1")
    assert refused.reason is RefusalReason.SUSPECT
    assert "x 3" in refused.message


@pytest.mark.parametrize("reason", [StopReason.FORCE_LIMIT, StopReason.CONTACT])
def test_a_module_that_jams_on_its_way_in_is_drawn_out_by_the_advice(holding, reason):
    """STOW and MOVE are refused from inside a seat."""
    script = holding.elaborate("PLACE MACS-NEW ON RACK-1")
    bound = holding.bind(script, script.steps[1])
    report = holding.subsystem.perform(bound.primitive, bound)
    made = holding.analyze(bound, msgspec.structs.replace(report, reason=reason, measured=30.1, limit=30.0))
    assert made.verdict == "abort"
    assert "LIFT MACS-NEW BY 30 CM, then PLACE it again" in made.clears

"""Cameras in physics: the scenario's displaced modules, found in drawn pictures (O1, O1b of the scenario)."""

from __future__ import annotations

import math

import pytest

from rtc.protocol.messages import Validity
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line

pytestmark = pytest.mark.physics

MODULE, OTHER = "MACS-NEW", "MACS-OLD"
GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"


def assert_known(physical, body: str) -> None:
    """The fact is valid, and the truth is within its bounds."""
    fact, true = physical.world.get(f"{body}.frame"), physical.subsystem.sim.truth()["poses"][body]
    off = geometry.relative(fact.value, true)
    errors = [*off[:3], *geometry.to_rpy(off)]
    assert fact.validity is Validity.VALID
    assert geometry.distance(fact.value, true) < 0.005
    if fact.spread is not None:
        assert all(abs(error) <= bound for error, bound in zip(errors, fact.spread, strict=True)), (errors, fact.spread)


@pytest.mark.parametrize(
    "offset",
    [[0.0, 0.020, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, math.radians(-5.0)]],
    ids=["20 mm", "5 deg"],
)
def test_a_module_that_is_not_felt_is_found_by_the_camera(physical, offset) -> None:
    physical.subsystem.displace_and_turn(MODULE, offset)
    run = physical.do(GRASP)
    assert run.succeeded, [a.message for a in run.assessments]
    assert run.trims == [1]
    assert physical.subsystem.sim.held()["RIGHT-ARM"] == [MODULE]
    assert_known(physical, MODULE)


def test_a_module_too_far_away_is_a_failure_with_its_cause_and_can_be_located_then(physical) -> None:
    """A finger lands on the handle: 45 mm is outside the straddle."""
    physical.subsystem.displace(MODULE, [0.0, 0.045, 0.0])
    run = physical.do(GRASP)
    assert run.failure.reason is StopReason.FORCE_LIMIT
    assert "straddle HANDLE-A" in run.failure.message  # wording: the step
    assert f"LOCATE {MODULE}" in in_one_line(run.failure.clears)
    assert physical.world.get(f"{MODULE}.frame").validity is Validity.SUSPECT

    for sentence in (f"LOCATE {MODULE}", GRASP):
        run = physical.do(sentence)
        assert run.succeeded, [a.message for a in run.assessments]
        assert run.trims == []
    assert physical.subsystem.sim.held()["RIGHT-ARM"] == [MODULE]


def test_what_was_located_is_grasped_without_a_trim(physical) -> None:
    physical.unsurveyed()
    physical.subsystem.displace(OTHER, [0.012, 0.016, 0.0])
    assert physical.do(f"LOCATE {OTHER}").succeeded
    assert_known(physical, OTHER)
    run = physical.do("GRASP LEFT-END-EFF MACS-OLD HANDLE-B")
    assert run.succeeded, [a.message for a in run.assessments]
    assert run.script.context.script == "grasp-centering"
    assert run.trims == []
    assert physical.subsystem.sim.held()["LEFT-ARM"] == [OTHER]


def test_a_module_moved_from_outside_is_met_then_doubted_then_looked_for(physical) -> None:
    """A fact does not age: it is believed until a camera or a touch contradicts it.

    The touch ends the motion safely, and a camera looks before the next step that needs the module.
    """
    assert physical.do(f"LOCATE {OTHER}").succeeded
    physical.subsystem.displace(OTHER, [-0.05, -0.10, 0.0])
    assert physical.world.get(f"{OTHER}.frame").validity is Validity.VALID

    run = physical.do("MOVE LEFT-ARM BY 40 CM ALONG DOWN MAINTAIN SPEED 5 CM/S")
    assert run.failure.reason in (StopReason.COLLISION, StopReason.FORCE_LIMIT)
    assert physical.world.get(f"{OTHER}.frame").validity is Validity.SUSPECT
    assert physical.subsystem.executors["LEFT-ARM"].at_rest

    for sentence in ("RETRACT LEFT-ARM BY 10 CM", "GRASP LEFT-END-EFF MACS-OLD HANDLE-B"):
        run = physical.do(sentence)
        assert run.succeeded, (sentence, run.refusal, [a.message for a in run.assessments])
    assert run.labels[0].startswith(f"look for {OTHER}")
    assert physical.subsystem.sim.held()["LEFT-ARM"] == [OTHER]
    assert_known(physical, OTHER)

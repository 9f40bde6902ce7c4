"""What nothing has measured is not stated: valid facts against the simulator's truth."""

from __future__ import annotations

import math

import msgspec
import pytest

from benchmarks.grasp import GraspRun, perform, runs, wilson
from rtc.protocol import faults as f
from rtc.protocol.messages import Validity
from rtc.protocol.outcomes import RefusalReason
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line
from sim_mcm.faults import Injections
from tests.campaigns.against_truth import judge

RIGHT, MODULE = "RIGHT-ARM", "MACS-NEW"
GRASP = f"GRASP {MODULE} HANDLE-A WITH {RIGHT}"


def displaced(cameras, *offset, bay=False):
    """A run with the module displaced by x y z (mm) and roll pitch yaw (degrees)."""
    x, y, z, *angles = offset
    far = [1e-3 * x, 1e-3 * y, 1e-3 * z, *map(math.radians, angles)]
    return GraspRun(0, RIGHT, "HANDLE-A", bay, False, cameras, 1.0, 1.0, far)


def disagreements(bench):
    sim = bench.subsystem.sim
    found = judge(bench.world.facts.values(), {**sim.truth(), "held": sim.held()})
    assert found.checked
    return [*found.wrong, *found.outside]


@pytest.mark.physics
@pytest.mark.parametrize(
    "run",
    [
        displaced(False, 0, 0, 0, 3, 0, 0),
        displaced(True, 20, -10, 15, -3, 3, 2),
        displaced(True, -15, 10, 5, 3, -2, -3, bay=True),
    ],
    ids=["roll felt", "seen in the rack", "seen in the bay"],
)
def test_a_tilted_module_is_grasped_and_no_fact_is_outside_its_spread(run) -> None:
    perform(run, short=True)
    assert run.grasped, run.in_words()
    assert not run.bad, run.in_words()


@pytest.mark.physics
def test_a_grasp_that_nothing_can_measure_is_refused_and_its_advice_clears_it() -> None:
    """In the bay there is no room to feel all axes of the handle; without cameras it is not taken blindly."""
    run = perform(displaced(False, 10, 5, -10, 2, 0, 0, bay=True), short=True)
    assert "too uncertain" in run.failed
    assert not run.bad, run.in_words()


@pytest.mark.physics
def test_a_module_that_a_seat_turns_in_the_hand_is_believed_in_the_seat() -> None:
    """On a tilted rack the module is pressed flat while the pads turn on its bar; the fingers do not measure that."""
    (run,) = runs(1, first=25)
    perform(run)
    assert run.placed, run.in_words()
    assert not run.bad, run.in_words()


@pytest.mark.physics
def test_after_a_drop_no_fact_of_hand_or_seat_is_wrong(physical) -> None:
    """The hand fails while the module is half out of its slot, and goes on opening after the report."""
    for sentence in (GRASP, f"LIFT {MODULE} BY 10 CM"):
        assert physical.do(sentence).succeeded
    subsystem = physical.subsystem
    faults = Injections(subsystem.sim.cell, subsystem.sim, subsystem.executors)
    assert faults.inject(f.FailedHand(arm=RIGHT)) == ""

    assert not physical.do(f"MOVE {RIGHT} BY 5 CM ALONG UP").succeeded

    for _ in range(300):
        subsystem.tick()
    assert disagreements(physical) == []
    assert physical.world.get(f"{MODULE}.seat").validity is not Validity.VALID


def test_the_advice_after_a_failure_in_a_seat_names_the_seat(bench) -> None:
    bench.without_cameras()
    for sentence in (GRASP, f"LIFT {MODULE} BY 20 CM"):
        assert bench.do(sentence).succeeded
    bench.subsystem.seats = False  # nothing is touched where the bottom of the seat should be
    failed = bench.do(f"PLACE {MODULE} ON BAY-2").failure
    assert "SET BAY-2 FRAME 93 0 70 CM 0 0 0 DEG" in in_one_line(failed.clears)
    refused = bench.elaborate(f"PLACE {MODULE} ON BAY-2")
    assert refused.reason is RefusalReason.SUSPECT


def test_an_object_that_a_camera_has_missed_is_felt(bench) -> None:
    bench.unsurveyed()
    assert bench.elaborate(GRASP).context.script != "grasp-feeling"
    bench.subsystem.eyes.blind = True
    assert not bench.do(GRASP).succeeded
    assert bench.elaborate(GRASP).context.script == "grasp-feeling"


def test_a_run_of_the_benchmark_always_has_the_same_conditions() -> None:
    (again,) = runs(1, first=7)
    assert msgspec.to_builtins(list(runs(8))[7].offset) == again.offset
    assert geometry.angle(geometry.IDENTITY, geometry.from_rpy([0, 0, 0], again.offset[3:])) < 0.13
    assert wilson(300, 300)[0] == pytest.approx(0.987, abs=0.001)

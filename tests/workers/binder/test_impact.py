"""A touch that a step expects with a load in the hand is felt well within the force limit of the step. Pure."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtc.model.cells.cell import Cell
from rtc.model.robot.quintic import Hermite
from rtc.protocol.messages import BoundStep, Script
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import ForceAbove, JointTrajectory
from rtc.spatial import axis_names, geometry, hinges
from rtc.subsystems.motion.arm import TICK_S
from tests.workers.conftest import Bench, Reporter
from workers.planning.robot_models import CellModel

SERVICING = CellModel(Cell.load("servicing"))
OPEN_RAD = math.radians(95.0)
ARM, MODULE, DRIVER = "RIGHT-ARM", "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", "GRASP RIGHT-END-EFF POWER-DRIVER TOOL-GRIP"
SHARE = 2 / 3  # of the force limit; a third is the room that a threshold must have (docs/physics.md)


@pytest.fixture
def bench() -> Bench:
    """A cell whose door stands open, on perfect reports."""
    made = Bench(Reporter(SERVICING.cell), SERVICING)
    door = SERVICING.cell.object("DOOR-2")
    made.set_fact("DOOR-2.angle", OPEN_RAD)
    made.set_fact("DOOR-2.frame", hinges.turned(door.frame.pose, door.hinge.axis, OPEN_RAD).tolist())
    return made


def meeting(bench: Bench, sentence: str) -> list[BoundStep]:
    """The steps of a sentence that meet something with a load. Those up to the first turn of a bolt are performed."""
    script = bench.elaborate(sentence)
    assert isinstance(script, Script), script
    found, turned = [], False
    for step in script.steps:
        bound = bench.bind(script, step)
        assert isinstance(bound, BoundStep), bound
        turned = turned or step.do == "turn"
        if (StopReason.CONTACT in step.expect and step.stop != "tug") or step.presses:
            found.append(bound)
        if not turned:
            report = bench.subsystem.perform(bound.primitive, bound)
            bench.world = bench.world.overlay(bench.analyze(bound, report).changes)
    return found


def felt_n(bound: BoundStep) -> float:
    """What a rigid body feels if it takes up the momentum of the tcp within a tick, where that is greatest."""
    made, model = bound.primitive, SERVICING.arms[ARM]
    load_kg = made.control_law.load.mass_kg
    if not isinstance(made.trajectory, JointTrajectory):
        here, compliance = np.array(bound.evaluation.start_joints), made.control_law.compliance
        way = geometry.rotate(model.fk(here), axis_names.AXES[bound.evaluation.step.axis][1])
        mass_kg = model.effective_mass_kg(here, way) + load_kg
        return mass_kg * compliance.approach_m_s / TICK_S + max(filter(None, compliance.wrench))
    path = made.trajectory
    curve = Hermite(*map(np.array, (path.time_s, path.positions, path.velocities, path.accelerations)))
    momenta = [0.0]
    for q, v, _ in curve.at(np.linspace(0.0, path.time_s[-1], 50)):
        rate = model.jacobian(q)[:3] @ v
        if (speed := float(np.linalg.norm(rate))) > 1e-6:
            momenta.append((model.effective_mass_kg(q, rate / speed) + load_kg) * speed)
    return max(momenta) / TICK_S


@pytest.mark.parametrize(
    ("before", "sentence", "least"),
    [
        ([MODULE, "EXTRACT MACS-NEW FROM RACK-1 WITH RIGHT-ARM"], "PLACE MACS-NEW ON RACK-1 WITH RIGHT-ARM", 1),
        ([MODULE, "EXTRACT MACS-NEW FROM RACK-1 WITH RIGHT-ARM"], "PLACE MACS-NEW ON RACK-1 WITH RIGHT-ARM GUARDED", 1),
        ([DRIVER], "PLACE POWER-DRIVER ON TOOL-RACK WITH RIGHT-ARM", 1),
        ([DRIVER], "PLACE POWER-DRIVER ON TOOL-RACK WITH RIGHT-ARM GUARDED", 1),
        ([DRIVER], "LOOSEN BOLT-1 BY 8 TURNS WITH RIGHT-ARM", 4),
        ([DRIVER], "LOOSEN BOLT-1 BY 8 TURNS WITH RIGHT-ARM MAINTAIN FORCE-LIMIT 16 N", 4),
        ([DRIVER], "LOOSEN BOLT-2 BY 8 TURNS WITH RIGHT-ARM GUARDED", 4),
        ([DRIVER], "VERIFY BOLT-1 AT TIGHT", 2),
    ],
)
def test_what_is_met_with_a_load_is_felt_within_two_thirds_of_the_limit(
    bench, before, sentence: str, least: int
) -> None:
    for one in before:
        assert bench.do(one).succeeded, one
    steps = meeting(bench, sentence)
    assert len(steps) >= least
    for bound in steps:
        faults = [stop.when for stop in bound.primitive.stop_functions if stop.reason is StopReason.FORCE_LIMIT]
        limit_n = min(when.limit_n for when in faults if isinstance(when, ForceAbove))
        assert felt_n(bound) <= 1.1 * SHARE * limit_n, bound.evaluation.step.label

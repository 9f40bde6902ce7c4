"""The cells beside the default one: sentences take and lift, on a moving base in physics, and at a second satellite."""

from __future__ import annotations

import pytest

from rtc.model.cells.cell import Cell
from rtc.spatial import geometry
from tests.workers.conftest import Bench, Physical, Reporter
from workers.planning.robot_models import CellModel


def bench_of(name, simulation):
    cell = Cell.load(name)
    return Bench(simulation(cell), CellModel(cell))


def do(bench, *sentences):
    for sentence in sentences:
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.failure)


@pytest.mark.physics
def test_an_arm_on_a_moving_base_takes_lifts_and_carries_in_physics():
    bench = bench_of("gantry", Physical)
    try:
        do(bench, "GRASP MACS-NEW HANDLE-A", "LIFT MACS-NEW BY 15 CM", "MOVE ARM GANTRY BY 10 CM ALONG LEFT")
        true = bench.subsystem.sim.truth()["poses"]["MACS-NEW"]
        assert geometry.distance(bench.world.value("MACS-NEW.frame"), true) < 0.005
        assert bench.do("MOVE ARM GANTRY BY 2 CM ALONG UP").reports[-1].slides == [0, 1]  # m, not rad
    finally:
        bench.subsystem.close()


def test_a_battery_of_the_second_satellite_goes_to_a_rack():
    bench = bench_of("relay", Reporter)
    do(bench, "GRASP BATTERY-OLD", "LIFT BATTERY-OLD BY 25 CM", "PLACE BATTERY-OLD ON RACK-2", "STOW LEFT-ARM")
    assert bench.world.value("BATTERY-OLD.seat") == "RACK-2"

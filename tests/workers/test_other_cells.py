"""The cells beside the default one: sentences take and lift, on a moving base in physics, and at a second satellite."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

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


def off_seat_m(bench, thing, seat):
    """How far a thing truly is from its seat (m)."""
    truth = bench.subsystem.sim.truth()
    return geometry.distance(truth["poses"][thing], truth["seats"][seat])


def without_the_old_battery() -> Cell:
    """The first half of the exchange is done: that test performs it on perfect reports."""
    cell = Cell.load("relay")
    objects = [thing if thing.name != "BATTERY-OLD" else replace(thing, seat="RACK-2") for thing in cell.objects]
    return replace(cell, objects=objects)


@pytest.mark.physics
@pytest.mark.parametrize(
    ("cell", "thing", "rack", "seat"),
    [
        pytest.param(
            without_the_old_battery, "BATTERY-NEW", "RACK-1", "BAY-B", id="the second satellite gets its battery"
        ),
        pytest.param(
            lambda: Cell.load("truss"), "STRUT-1", "RACK-1", "UPPER-CHORD", id="a strut is put into its nodes"
        ),
    ],
)
def test_other_jobs_need_data_only_in_physics(cell, thing, rack, seat):
    made = cell()
    bench = Bench(Physical(made), CellModel(made))
    try:
        do(
            bench,
            f"GRASP {thing} WITH RIGHT-ARM",
            f"EXTRACT {thing} FROM {rack} WITH RIGHT-ARM",
            f"INSERT {thing} INTO {seat} WITH RIGHT-ARM",
        )
        assert off_seat_m(bench, thing, seat) < 0.003
        assert bench.world.value(f"{thing}.seat") == seat
    finally:
        bench.subsystem.close()

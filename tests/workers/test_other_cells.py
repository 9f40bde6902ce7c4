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


def off_seat_m(bench, thing, seat):
    """How far a thing truly is from its seat (m)."""
    truth = bench.subsystem.sim.truth()
    return geometry.distance(truth["poses"][thing], truth["seats"][seat])


@pytest.mark.physics
@pytest.mark.parametrize(
    ("cell", "sentences", "seated"),
    [
        pytest.param(
            "relay",
            [
                "GRASP BATTERY-OLD WITH LEFT-ARM",
                "EXTRACT BATTERY-OLD FROM BAY-B WITH LEFT-ARM",
                "PLACE BATTERY-OLD ON RACK-2 WITH LEFT-ARM",
                "STOW LEFT-ARM",
                "GRASP BATTERY-NEW WITH RIGHT-ARM",
                "EXTRACT BATTERY-NEW FROM RACK-1 WITH RIGHT-ARM",
                "INSERT BATTERY-NEW INTO BAY-B WITH RIGHT-ARM",
            ],
            {"BATTERY-OLD": "RACK-2", "BATTERY-NEW": "BAY-B"},
            id="the battery of a second satellite is exchanged",
        ),
        pytest.param(
            "truss",
            [
                "GRASP STRUT-1 WITH RIGHT-ARM",
                "EXTRACT STRUT-1 FROM RACK-1 WITH RIGHT-ARM",
                "INSERT STRUT-1 INTO UPPER-CHORD WITH RIGHT-ARM",
            ],
            {"STRUT-1": "UPPER-CHORD"},
            id="a strut is put into its nodes",
        ),
    ],
)
def test_other_jobs_need_data_only_in_physics(cell, sentences, seated):
    bench = bench_of(cell, Physical)
    try:
        do(bench, *sentences)
        for thing, seat in seated.items():
            assert off_seat_m(bench, thing, seat) < 0.003
            assert bench.world.value(f"{thing}.seat") == seat
    finally:
        bench.subsystem.close()

"""The cell says which subsystem performs an arm or a camera."""

from __future__ import annotations

import msgspec
import pytest

from rtc.model.cells.cell import Cell
from rtc.protocol.outcomes import Refused
from rtc.protocol.subsystems import DEFAULTS, Subsystem
from tests.workers.conftest import Bench, Reporter
from workers.planning.robot_models import CellModel

SECOND = Subsystem(name="MCM-2", module="sim_mcm", estop=True, performers=["LEFT-ARM"])


def with_subsystems(*subsystems: Subsystem, cameras: bool = False) -> Cell:
    cell = Cell.load("swapout")
    changes = {} if cameras else {"cameras": [], "tags": []}
    return msgspec.structs.replace(cell, subsystems=list(subsystems), **changes)


def test_a_cell_that_names_none_has_two() -> None:
    cell = Cell.load("swapout")
    arms, cameras = DEFAULTS
    assert {cell.subsystem_of(arm.name) for arm in cell.arms} == {arms.name}
    assert {cell.subsystem_of(camera.name) for camera in cell.cameras} == {cameras.name}


def test_one_entry_gives_an_arm_to_a_second_subsystem() -> None:
    cell = with_subsystems(SECOND)
    assert cell.subsystem_of("LEFT-ARM") == "MCM-2"
    assert cell.subsystem_of("RIGHT-ARM") == DEFAULTS[0].name
    assert [arm.name for arm in cell.of_subsystem("MCM-2").arms] == ["LEFT-ARM"]
    assert [arm.name for arm in cell.of_subsystem(DEFAULTS[0].name).arms] == ["RIGHT-ARM"]


@pytest.mark.parametrize(
    ("subsystems", "place"),
    [
        ([Subsystem(name="X", performers=["THIRD-ARM"])], "subsystems[0].performers"),
        ([SECOND, Subsystem(name="X", performers=["LEFT-ARM"])], "subsystems[1].performers"),
        ([Subsystem(name="X", performers=[])], "subsystems[0].performers"),
        ([Subsystem(name="X", module="sim_mcm", performers=["LEFT-ARM"])], "subsystems[0].estop"),
        ([Subsystem(name="X", estop=True, performers=["CAMERA-1"])], "subsystems[0].estop"),
        ([SECOND, msgspec.structs.replace(SECOND, performers=["RIGHT-ARM"])], "subsystems"),
    ],
)
def test_a_wrong_list_is_refused_with_its_place(subsystems: list[Subsystem], place: str) -> None:
    with pytest.raises(ValueError, match=rf"\$\.{place.replace('[', '.').replace(']', '.')}"):
        with_subsystems(*subsystems, cameras=any("CAMERA-1" in one.performers for one in subsystems))


def test_cameras_of_a_simulation_need_one_simulation() -> None:
    with pytest.raises(ValueError, match="subsystems"):
        with_subsystems(SECOND, cameras=True)


def test_each_motion_is_sent_to_the_subsystem_of_its_arm() -> None:
    model = CellModel(with_subsystems(SECOND))
    bench = Bench(Reporter(model.cell), model)
    for arm, owner in (("LEFT-ARM", "MCM-2"), ("RIGHT-ARM", DEFAULTS[0].name)):
        script = bench.elaborate(f"MOVE {arm} BY 5 CM ALONG UP")
        assert not isinstance(script, Refused)
        bound = bench.bind(script, script.steps[0])
        assert bound.subsystem == owner

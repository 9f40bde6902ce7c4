"""First cells of two arms that the project does not know, from the URDF files of pybullet_data."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pybullet_data
import pytest

from rtc.apps.authoring.draft import Draft, draft
from rtc.model.cells import two_readers
from rtc.model.cells.cell import Cell
from sim_mcm.arms import readers
from tests.apps.authoring import small_arms

DATA = Path(pybullet_data.getDataPath())
ARMS = {
    "PANDA": (DATA / "franka_panda" / "panda.urdf", ""),
    "IIWA": (DATA / "kuka_iiwa" / "model.urdf", ""),
    "XARM": (DATA / "xarm" / "xarm6_with_gripper.urdf", "link6"),
}


@pytest.fixture(autouse=True)
def compared_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """The two readers of a URDF are compared in this process, as its own takes 0.3 s to start; `test_page` has that."""
    monkeypatch.setattr(two_readers, "_answer", answer)


answer = cache(readers.answer)  # tests ask about the same arms


@pytest.fixture(scope="session")
def first_cell(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The file of the first cell of an arm, as `rtc cell new` writes it."""

    @cache
    def file_of(arm: str) -> Path:
        urdf, tip = ARMS[arm]
        return written(draft(urdf, arm, tip), tmp_path_factory.mktemp(arm.lower()))

    return file_of


@pytest.fixture(scope="session")
def small_file(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The file of the first cell of one of the small arms, which is named UNIT there."""

    @cache
    def file_of(kind: str) -> Path:
        folder = tmp_path_factory.mktemp(kind.lower())
        urdf = folder / "arm.urdf"
        urdf.write_text(small_arms.urdf("arm", getattr(small_arms, kind)))
        return written(draft(urdf, "UNIT"), folder)

    return file_of


@pytest.fixture(scope="session")
def small_cell(small_file: Callable[[str], Path]) -> Callable[[str], Cell]:
    return lambda kind: Cell.load(small_file(kind))


def written(found: Draft, folder: Path) -> Path:
    """The cell file, beside its other files."""
    for name, text in {**found.files, "cell.yaml": found.yaml}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder / "cell.yaml"


@pytest.fixture
def panda_cell(first_cell: Callable[[str], Path]) -> Cell:
    return Cell.load(first_cell("PANDA"))

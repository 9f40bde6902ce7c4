"""The default cell and its two arms, read once; how property tests choose their examples."""

from __future__ import annotations

import gc
import os
import signal

import pytest
from hypothesis import HealthCheck, settings

from rtc.model.cells.cell import Cell
from rtc.model.robot.collision import CollisionWorld
from rtc.model.robot.kinematics import ArmModel
from rtc.runtime import process, time_limit
from rtc.runtime.environment import physics_seed
from tests.plugins.toy_packages import install  # noqa: F401

# Under `nohup`, or behind `&` of a script, children would inherit an ignored SIGHUP or SIGINT, and tests of their
# handling would fail.
signal.signal(signal.SIGHUP, signal.SIG_DFL)
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# How long an example takes says nothing on a machine that runs other tests as well.
settings.register_profile("random", deadline=None, suppress_health_check=[HealthCheck.too_slow])
# Every run has the same examples, so that a failure is repeatable. Others: pytest --hypothesis-profile=random
settings.register_profile("repeatable", settings.get_profile("random"), derandomize=True)
settings.load_profile("repeatable")
time_limit.install()  # code of packages has the limits that it has in a cluster
gc.disable()  # until all tests are collected: what is imported and collected lives to the end


def pytest_report_header() -> str:
    return f"RTC_PHYSICS_SEED={physics_seed() or 'none: physics is as the cell files state'}"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The tests with a limit of their own, the longest, come first: none is left for one process at the end."""
    items.sort(key=lambda item: item.get_closest_marker("timeout") is None)


def pytest_collection_finish() -> None:
    """As the processes of a cluster do it: a collection of garbage looks at nothing that tests have not made."""
    gc.enable()
    process.freeze_heap()


@pytest.fixture(scope="session", autouse=True)
def own_data_dir(tmp_path_factory):
    """Places that the user has taught must not be in the worlds of tests."""
    os.environ["XDG_DATA_HOME"] = str(tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="session")
def cell():
    return Cell.load("swapout")


@pytest.fixture(scope="session")
def arms(cell):
    return {arm.name: ArmModel.of(cell, arm.name) for arm in cell.arms}


@pytest.fixture(scope="session")
def right(arms):
    return arms["RIGHT-ARM"]


@pytest.fixture(scope="session")
def left(arms):
    return arms["LEFT-ARM"]


@pytest.fixture(scope="session")
def home(cell):
    return {arm.name: arm.home_rad for arm in cell.arms}


@pytest.fixture(scope="session")
def world(cell):
    return CollisionWorld(cell)

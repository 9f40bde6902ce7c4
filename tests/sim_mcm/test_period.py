"""The order of a period: a halt is obeyed, then the servo ticks, then the cell moves on by one step."""

from __future__ import annotations

import ast

import pybullet
import pytest

from sim_mcm import __main__ as product
from sim_mcm.arms.bullet_arm import BulletCell
from tests.source_files import ROOT, place
from tests.subsystems.motion import conftest as servo
from tests.workers import conftest as bench
from tests.workers import one_process
from tests.workers.conftest import CELL
from tests.workers.one_process import OneProcess

ARM, PALM = "RIGHT-ARM", 7
PUSH_N = 20.0
# One measures the library's step alone; one puts an exact arm somewhere.
OWN_ORDER = {"benchmarks/mcm.py: _stepped", "tests/sim_mcm/test_faults.py: at_handle"}


def test_no_loop_has_an_order_of_its_own() -> None:
    """Product, tests, campaigns and benchmarks tick and step by one function."""
    found = set()
    for path in (path for folder in ("sim_mcm", "tests", "benchmarks") for path in (ROOT / folder).rglob("*.py")):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if ".step()" in text and ".tick(" in text else ():
            if isinstance(node, ast.FunctionDef) and {"tick", "step"} <= _called(node):
                found.add(f"{place(path)}: {node.name}")
    assert found <= OWN_ORDER


def test_the_harness_ticks_by_the_function_of_the_product() -> None:
    assert product.period is one_process.period
    assert product.period is bench.period
    assert product.period is servo.period


def _called(function: ast.FunctionDef) -> set[str]:
    calls = (node.func for node in ast.walk(function) if isinstance(node, ast.Call))
    return {called.attr for called in calls if isinstance(called, ast.Attribute)}


@pytest.mark.physics
def test_a_halt_of_a_compliant_arm_that_was_pushed_aside_does_not_jerk_it() -> None:
    """A step between halt and tick pulled it by position control towards where its spring was, at 3 rad/s."""
    sim = BulletCell(CELL)
    try:
        cluster = OneProcess(sim)
        cluster.give(f"HOLD {ARM} FOR 10 SEC MAINTAIN STIFFNESS 400 N/M")
        body, executor = sim.arms[ARM].body, cluster.mcm.executors[ARM]
        for _ in range(1500):
            tcp = sim.arms[ARM].tcp_pose(executor.sample.joints)[:3].tolist()
            up = (0.0, 0.0, PUSH_N)
            pybullet.applyExternalForce(body, PALM, up, tcp, pybullet.WORLD_FRAME, sim.world.client)
            cluster.tick()
        assert executor.moving
        cluster.halt("ALL")
        fastest = 0.0
        for _ in range(20):
            cluster.tick()
            fastest = max(fastest, *(abs(v) for v in executor.sample.velocities))
        assert not executor.moving
        assert fastest < 0.02
    finally:
        sim.close()

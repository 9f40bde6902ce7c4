"""The paper's example (R106): a new grasp strategy with data of its own, taken into use while another command runs.

A separately installed package plans a grasp point. A file brings the strategy: a script, its figures, and an attribute
of objects. The former strategies are switched off. A version whose first job fails is taken back.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.programs.loader import decode, default
from rtc.programs.schema import ElaboratorProgram
from rtc.protocol.outcomes import OutcomeKind

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

PLANNER = """
def grasps(thing, cell):
    frame = {"xyz": [-0.15, -0.085, 0], "rpy_deg": [0, 90, 0]}
    return [{"name": "BAR", "frame": frame, "width_m": 0.02}] if thing.name == "MACS-NEW" else []
"""
STRATEGY = """
script: grasp-bar
about: opens as wide as the bar of the object needs
case: 3
uses: [hand, object, grasp_point]
needs: [hand_empty, object_free]
resources: [active_arm, active_object]
writes: [active_arm, active_object, its_seat]
plan:
  - {name: GP, at: grasp_point}
  - {name: AP, at: GP, along: TOOL-Z, by: "-approach_m"}
steps:
  - {do: proc, name: grasp_init, label: "open for the bar", args: {width_m: object.bar_width_m + 0.05}}
  - {do: move, to: AP, stop: move_free, space: move_joint, label: "go before the bar"}
  - {do: move, to: GP, stop: move_to_contact, space: move_task, label: "go to the bar"}
  - {do: grip, op: close, label: "close on the bar", args: {grip_n: grip_n, least_m: 0.5*object.bar_width_m,
     most_m: 1.5*object.bar_width_m}, words: {effect: taken}}
settable: {bar_width: {unit: m, of: [bar_width], example: 12 MM}}
command_object_table: [{verb: GRASP, name: MACS-NEW, values: {grip_n: 1000*object.bar_width_m}}]
decision_tree:
  - {verb: GRASP, script: grasp-bar, when: [{equals: {grasp_point: BAR}}, {of: object.bar_width_m, at_least: 0.005}]}
"""
GRASP = "GRASP RIGHT-END-EFF MACS-NEW BAR"
LIMIT_S = 60.0


@pytest.fixture
def rtc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Client]:
    """A client of a cluster whose environment has the package."""
    (tmp_path / "toy_bars.py").write_text(PLANNER)
    info = tmp_path / "toy_bars-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: toy_bars\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[rtc.grasp_planners]\nbars = toy_bars:grasps\n")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    with own_cluster(cell="swapout", mcm="kinematic", speed="max", dim=2) as run_dir, Client(run_dir) as client:
        yield client


def do(rtc: Client, sentence: str) -> set[str]:
    """The steps of a command that has succeeded."""
    end = rtc.run(sentence, timeout_s=LIMIT_S)
    assert end.outcome.kind is OutcomeKind.SUCCEEDED, end
    by_package = any("grasp planner bars" in note.message for note in rtc.trace(end.command).notes)
    assert by_package is (sentence == GRASP)
    return {note.step.partition(": ")[2] for note in rtc.trace(end.command).notes if note.step}


def test_a_new_grasp_strategy_is_added_while_another_command_runs(rtc: Client, tmp_path: Path) -> None:
    other = rtc.submit("HOLD LEFT-ARM")
    rows = decode(default("elaborator"), ElaboratorProgram).decision_tree
    off = "".join(f"  - {{verb: GRASP, script: {row.script}, enabled: false}}\n" for row in rows if row.verb == "GRASP")
    strategy = tmp_path / "grasp-bar.yaml"
    before = rtc.program("elaborator").digest
    assert "close on the bar" not in do(rtc, GRASP)  # by one of the former strategies
    do(rtc, "RELEASE MACS-NEW")

    # The data are stated. A version that fails with them is taken back by its first job, which the former does.
    do(rtc, "SET MACS-NEW BAR-WIDTH 20 MM")
    strategy.write_text(STRATEGY.replace("+ 0.05}", "+ 0.001/(object.bar_width_m - 0.02)}") + off)
    rtc.load("elaborator", strategy)
    assert "close on the bar" not in do(rtc, GRASP)
    assert rtc.program("elaborator").digest == before
    assert "elaborator" in rtc.status().rolled_back
    do(rtc, "RELEASE MACS-NEW")

    # The right version: the next GRASP uses it, with the figures of the object.
    strategy.write_text(STRATEGY + off)
    rtc.load("elaborator", strategy)
    assert "close on the bar" in do(rtc, GRASP)
    assert [entry.file for entry in rtc.program("elaborator").history[:2]] == [strategy.name] * 2
    assert other.number in {row.command for row in rtc.status().commands}  # nothing of it has disturbed the other

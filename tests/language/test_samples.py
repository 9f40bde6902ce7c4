"""All sentences of samples.txt: what each ends in, in a cell and a state in which it has a meaning.

A sentence succeeds, or its refusal is true there: it names what the cell lacks, or why the verb cannot be performed.
Tasks are executed on perfect reports; what the broker itself performs, and what refers to other commands, in a cluster
in one process with exact arms.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from rtc.model.cells.cell import Cell
from rtc.protocol.messages import Phase, Script
from rtc.protocol.outcomes import OutcomeKind
from rtc.spatial import hinges
from sim_mcm.arms.kinematic_arm import KinematicCell
from tests.workers.conftest import CELL, Bench, Reporter
from tests.workers.eyes import Ideal
from tests.workers.one_process import OneProcess
from workers.planning.robot_models import CellModel

SAMPLES = dict(line.split(": ", 1) for line in Path(__file__).with_name("samples.txt").read_text().splitlines())
SERVICING = CellModel(Cell.load("servicing"))
SWAPOUT = CellModel(CELL)
OUT = ("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", "EXTRACT MACS-NEW FROM RACK-1")
BOTH = (*OUT, "CARRY MACS-NEW TO CLEAR-POINT-1 WITH BOTH-ARMS", "MOVE BOTH-ARMS BY 20 CM ALONG DOWN")
UNBOLTED = ("SET BOLT-1 STATE LOOSE", "SET BOLT-2 STATE LOOSE")
OLD = (*UNBOLTED, "GRASP RIGHT-END-EFF MACS-OLD HANDLE-A")
DRIVER = ("GRASP RIGHT-END-EFF POWER-DRIVER TOOL-GRIP",)
OLD_OUT = (*OLD, "EXTRACT MACS-OLD FROM BAY-2")
DOOR = ("GRASP LEFT-END-EFF DOOR-2 LATCH-PULL",)


class Sample(NamedTuple):
    """What a sentence ends in, after the sentences before it. `words`: of the refusal; empty: it succeeds."""

    words: str = ""
    before: tuple[str, ...] = ()
    model: CellModel = SERVICING
    door_deg: float = 95.0  # the door of `servicing`
    planned: bool = False  # it is not executed here


OK = Sample()
CLOSED = 0.0
#: tasks, and sentences that state or ask facts
TASKS: dict[str, Sample] = {
    "S1": Sample(model=SWAPOUT),
    "S2": Sample("no object OBJECT"),
    "S3": Sample("no object OBJECT"),
    "S4": Sample("no object OBJECT"),
    "S5": OK,
    "S6": OK,
    "S7": Sample("joint_3"),  # 90 deg is beyond its limit
    "S8": OK,
    "S9": OK,
    "S10": Sample("no arm GANTRY"),
    "S11": OK,
    "S12": Sample(before=DRIVER),
    "S13": OK,
    "S14": Sample(before=BOTH, model=SWAPOUT),
    "S15": Sample(before=(*DOOR, "PULL DOOR-2 BY 10 CM"), door_deg=CLOSED),
    "S16": Sample("no object CONNECTOR-J4"),
    "S17": Sample("RIGHT-ARM cannot reach", OLD_OUT),  # RACK-2 is that of the left arm
    "S18": Sample(before=OUT, model=SWAPOUT),
    "S19": Sample(before=OLD),
    "S20": Sample(before=OUT, model=SWAPOUT),
    "S21": Sample(before=DRIVER, planned=True),
    "S22": Sample("AND TRY REGRASP: TIGHTEN has no use for it", DRIVER),
    "S23": Sample("no object CRANK-1"),
    "S24": Sample(before=DOOR, door_deg=CLOSED),
    "S25": OK,
    "S26": Sample("150 mm is asked for"),  # the hand is open by 80 mm
    "S27": Sample("no object PANEL-1"),
    "S28": Sample(before=OLD_OUT),
    "S29": OK,
    "S30": OK,
    "S31": OK,
    "S32": Sample(planned=True),  # a minute of pictures takes seconds; other tests execute TRACK
    "S33": Sample(before=OLD),
    "S34": Sample(planned=True),  # the operator performs it
    "S35": Sample("no place DOOR-2-FRONT"),
    "S36": Sample(before=OLD),
    "S39": Sample("no object TOOL-1"),
    "S47": OK,
    "S48": OK,
    "S49": OK,
    "S50": OK,
    "S51": Sample("BOLT-2 is fixed"),
    "S52": OK,
    "S54": Sample(planned=True),
    "S55": Sample("answers what the operator does now"),
    "S56": Sample("answers what the operator does now"),
    "S57": Sample("answers what the operator does now"),
    "S58": Sample(door_deg=CLOSED),
    "S59": Sample("no region ANTENNA"),
}


def earlier(number: int, last: str) -> tuple[str, ...]:
    """Sentences whose last one is the command of this number."""
    return (*["SHOW RESOURCES"] * (number - 1), last)


MOVES, GRASPS = "MOVE RIGHT-ARM BY 5 CM ALONG BACK", "GRASP MACS-NEW WITH RIGHT-ARM"
#: what the broker decides: control, other commands, programs. The last sentence before it is still in progress
BROKER: dict[str, Sample] = {
    "S37": Sample(before=earlier(12, "HOLD LEFT-ARM FOR 1 SEC")),
    "S38": Sample("BOLT-2 has no tags", earlier(9, MOVES)),
    "S40": Sample("is not held"),
    "S41": Sample(before=(MOVES,)),
    "S42": Sample(before=(MOVES,)),
    "S43": Sample(before=("HOLD LEFT-ARM FOR 9 SEC",)),
    "S44": Sample(before=earlier(7, GRASPS)),
    "S45": Sample(before=(*earlier(7, GRASPS), "PAUSE C-7")),
    "S46": Sample(before=earlier(7, MOVES)),
    "S53": OK,
}


def test_each_sample_is_tried() -> None:
    assert len(SAMPLES) == 59
    assert TASKS.keys() | BROKER.keys() == SAMPLES.keys()


def bench_of(sample: Sample) -> Bench:
    """The cell with its door at an angle, and what the sentences before have done in it."""
    cell = sample.model.cell
    bench = Bench(Reporter(cell), sample.model)
    for thing in cell.objects:
        if thing.hinge is not None:
            angle = math.radians(sample.door_deg)
            frame = hinges.turned(thing.frame.pose, thing.hinge.axis, angle)
            bench.subsystem.poses[thing.name] = np.asarray(frame)
            bench.set_fact(f"{thing.name}.angle", angle)
            bench.set_fact(f"{thing.name}.frame", frame.tolist())
    for sentence in sample.before:
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.failure)
    return bench


@pytest.mark.parametrize("name", TASKS)
def test_a_sample_succeeds_or_its_refusal_is_true_of_the_cell(name: str) -> None:
    sample = TASKS[name]
    if sample.planned:
        assert isinstance(bench_of(sample).elaborate(SAMPLES[name]), Script)
        return
    run = bench_of(sample).do(SAMPLES[name])
    if not sample.words:
        assert run.succeeded, (run.refusal, run.failure)
        return
    refused: Any = run.refusal or run.failure
    assert sample.words in refused.message  # wording: as the page of the sample has it
    assert refused.clears or run.refusal.expected


@pytest.mark.parametrize("name", BROKER)
def test_a_sample_for_the_broker_succeeds_or_its_refusal_is_true(name: str) -> None:
    sample = BROKER[name]
    cluster = OneProcess(KinematicCell(SERVICING.cell), SERVICING, eyes=Ideal(SERVICING.cell))
    for sentence in sample.before:
        given = cluster.give(sentence)
        while given not in cluster.outcomes and cluster.state.commands[given].phase is not Phase.EXECUTING:
            cluster.tick()
    command = cluster.give(SAMPLES[name])
    while command not in cluster.outcomes:
        cluster.tick()
    outcome = cluster.outcomes[command]
    assert outcome.kind is (OutcomeKind.REFUSED if sample.words else OutcomeKind.SUCCEEDED), outcome
    assert sample.words in outcome.message  # wording: as the page of the sample has it

"""What goes wrong in the swap-out: which lines lead to it, and that its check finds another chain than the wanted."""

from __future__ import annotations

import io
import math
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from examples.swapout import lines, swapout
from examples.swapout.injections import CELL, HALFWAY, Scene
from rtc.apps.demos.narrator import Narrator
from rtc.model.cells.cell import Cell
from rtc.protocol import messages as m
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry
from rtc.world.model import World, initial_facts
from tests.campaigns import injections
from tests.campaigns.injections import INJECTIONS
from tests.workers.conftest import record

TEXTS = {line.label: line.text for line in lines.read(swapout.LINES.read_text())}


def test_all_ten_of_the_scenario_exist():
    assert {*injections.NAMES} == {f"O{n}" for n in range(1, 11)}


@pytest.mark.parametrize("name", INJECTIONS)
def test_its_line_is_the_last_and_its_sentence_has_the_verb_of_the_task(name):
    what = INJECTIONS[name]
    assert set(what.lines) <= TEXTS.keys()
    assert what.lines[-1] == what.at
    if what.text:
        assert record(what.text).verb == record(TEXTS[what.at]).verb
    Cell.load(what.cell)


def test_halfway_the_door_is_open_the_bay_is_empty_and_its_bolts_fasten_nothing():
    cell = Cell.load(HALFWAY)
    world = World().overlay(initial_facts(cell))
    assert world.value("DOOR-2.angle") == pytest.approx(math.radians(90.0))
    assert {thing.name: thing.seat for thing in cell.objects if thing.kind == "module"} == {
        "MACS-OLD": "RACK-2",
        "MACS-NEW": "RACK-1",
    }
    assert cell.seat("BAY-2").bolts == []
    whole = Cell.load(CELL)
    assert geometry.distance(cell.seated_pose("BAY-2"), whole.seated_pose("BAY-2")) == 0.0


def test_a_binder_is_killed_once_in_a_step_and_not_again_once_its_loss_is_known(monkeypatch):
    """The next note of the same step may arrive before the loss is known."""
    killed: list[str] = []
    known: list[m.ProgressNote] = []

    def strike(kind: str, name: str) -> SimpleNamespace:
        killed.append(name)
        return SimpleNamespace(name=name)

    monkeypatch.setattr(injections, "Chaos", lambda *_: SimpleNamespace(strike=strike))
    busy = SimpleNamespace(kind="binder", name="binder@2", busy_with="C-1/3")
    rtc = SimpleNamespace(status=lambda: SimpleNamespace(workers=[busy]), trace=lambda _: SimpleNamespace(notes=known))
    scene = Scene(None, rtc)  # type: ignore[arg-type]
    o7, line = INJECTIONS["O7"], lines.Line("C22", "")
    for step in ("1 of 3", "1 of 3", "2 of 3"):
        o7.notes(scene, line, m.ProgressNote(seq=1, at_s=0.0, command="C-1", phase=m.Phase.BINDING, step=step))
    assert len(killed) == 2
    known.append(note("2 of 3", kind=m.NoteKind.WORKER_LOST, about="binder@2"))
    o7.notes(scene, line, m.ProgressNote(seq=1, at_s=0.0, command="C-1", phase=m.Phase.BINDING, step="3 of 3"))
    assert len(killed) == 2


def note(step: str, node: str = "analyzer@3", **facts: Any) -> m.ProgressNote:
    kind = m.NoteKind.TRIM if "trim" in facts else m.NoteKind.JUDGED
    facts = {"kind": kind, **facts}
    return m.ProgressNote(seq=1, at_s=0.0, command="C-1", phase=m.Phase.ANALYZING, step=step, node=node, **facts)


def step_ended(reason: StopReason) -> m.ProgressNote:
    return note("carry MACS-NEW with both arms", node="MCM", kind=m.NoteKind.STEP_ENDED, reason=reason)


FLAGGED = note("bring MACS-NEW to CLEAR-POINT-1", message="weaker", trim=4, warning=True)
AGAIN = [note("close again on MACS-NEW"), step_ended(StopReason.GOAL)]
SLIPPED = step_ended(StopReason.SLIP)


@pytest.mark.parametrize(
    ("notes", "passes"),
    [
        ([FLAGGED, *AGAIN], True),
        (AGAIN, False),  # nothing was flagged
        ([FLAGGED, *AGAIN, SLIPPED], False),
        ([FLAGGED, AGAIN[1]], False),  # it did not close again
        ([note("bring MACS-NEW", message="slip", trim=1), *AGAIN], False),  # a failure, not a drift
    ],
)
def test_a_weak_grip_must_be_flagged_before_it_is_lost(notes, passes):
    assert checked("O10", "C25", notes) is passes


CLOSURES = ["close on HANDLE-A", "open again", "back off from", "to before (AP)", "(NP)", "(GP)", "close on HANDLE-A"]


@pytest.mark.parametrize(
    ("trims", "steps", "holder", "passes"),
    [
        ([1], CLOSURES, "RIGHT-ARM", True),
        ([1], CLOSURES, "", False),
        ([1, 1], CLOSURES, "RIGHT-ARM", False),  # twice
        ([], CLOSURES[-1:], "RIGHT-ARM", False),
        ([1], CLOSURES[:2] + CLOSURES[-1:], "RIGHT-ARM", False),  # not from the start
    ],
)
def test_a_bad_first_closure_must_be_repeated_once_from_the_start(trims, steps, holder, passes):
    notes = [note(step) for step in steps]
    notes[:0] = [note("close on HANDLE-A", trim=trim) for trim in trims]
    assert checked("O2", "C22", notes, {"MACS-NEW.held_by": holder}) is passes


def checked(name: str, label: str, notes: list[m.ProgressNote], facts: dict[str, str] | None = None) -> bool:
    """Whether the check of an injection passes on this trace."""
    narrator = Narrator(Console(file=io.StringIO()))
    narrator.check("something else", True)
    known = [SimpleNamespace(value=value, validity=m.Validity.VALID) for value in (facts or {}).values()]
    rtc = SimpleNamespace(
        trace=lambda command: SimpleNamespace(notes=notes),
        world=SimpleNamespace(view=lambda keys: SimpleNamespace(facts=known)),
    )
    course = lines.Course(commands={label: "C-1"})
    INJECTIONS[name].check(narrator, Scene(None, rtc), course)  # type: ignore[arg-type]
    return narrator.passed()

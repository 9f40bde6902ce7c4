"""LOAD name INTO kind: the broker loads a delivered part itself, and answers as a worker would."""

from __future__ import annotations

import pytest

from broker.decisions import effects as do
from broker.decisions import events
from broker.persistence.program_store import StoredProgram
from broker.router import part_loads
from rtc.programs import loader
from rtc.protocol.messages import ProgramText, WorkerKind
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason
from rtc.wording.advice import in_one_line
from sim_mcm.arms.kinematic_arm import KinematicCell
from tests.workers.conftest import CELL
from tests.workers.one_process import OneProcess


def ended(sentence: str) -> object:
    cluster = OneProcess(KinematicCell(CELL))
    command = cluster.give(sentence)
    cluster.run()
    return cluster.outcomes[command]


def test_the_result_of_a_load_states_what_has_changed() -> None:
    outcome = ended("LOAD CENTERING-GRASP INTO ELABORATOR")
    assert outcome.kind is OutcomeKind.SUCCEEDED
    assert "grasp_centering.yaml is in use already" in outcome.message  # wording: it is the answer


def test_a_load_into_no_kind_of_worker_is_refused() -> None:
    outcome = ended("LOAD CENTERING-GRASP INTO ROBOT")
    assert outcome.kind is OutcomeKind.REFUSED
    assert "ELABORATOR" in in_one_line(outcome.refusal.clears)


@pytest.mark.parametrize(
    ("kind", "name", "file"),
    [
        (WorkerKind.ELABORATOR, "CENTERING-GRASP", "grasp_centering.yaml"),
        (WorkerKind.ELABORATOR, "OPEN-DOOR", "door.yaml"),
        (WorkerKind.ELABORATOR, "DECISION-TREE", "decision_tree.yaml"),
        (WorkerKind.ELABORATOR, "LIFT-SCRIPT", "lift.yaml"),
        (WorkerKind.BINDER, "PROGRAM", "program.yaml"),
        (WorkerKind.PARSER, "GRAMMAR", "command.lark"),
        (WorkerKind.ELABORATOR, "MAGIC", None),
    ],
)
def test_a_part_is_found_by_its_words(kind: WorkerKind, name: str, file: str | None) -> None:
    path = loader.part(kind, name)
    assert (path.name if path else None) == file


LOAD = do.LoadPart(job="C-7/2", attempt=1, kind=WorkerKind.ELABORATOR, name="LIFT-SCRIPT")
TEXT = ProgramText(request="C-7/2", kind=WorkerKind.ELABORATOR, name="lift.yaml", body=b"")


def test_a_load_that_ends_is_the_end_of_its_job() -> None:
    made = part_loads.answer(LOAD, TEXT, StoredProgram("d", ["scripts: lift is changed"]), 3.0)
    assert isinstance(made, events.JobFinished)
    assert (made.job, made.attempt) == ("C-7/2", 1)
    assert b"scripts: lift is changed" in bytes(made.product)


def test_a_load_that_does_not_check_refuses_its_command_without_another_program() -> None:
    made = part_loads.answer(LOAD, TEXT, Refusal(reason=RefusalReason.PROGRAM, message="no stop class x"), 3.0)
    assert isinstance(made, events.JobDeclined)
    assert made.refusal.reason is RefusalReason.STATE  # PROGRAM would be repeated with another program


def test_a_lost_load_is_given_again() -> None:
    """After a restart of the broker the job is dispatched again, as any pending one."""
    cluster = OneProcess(KinematicCell(CELL))
    given: list[do.LoadPart] = []
    cluster._loaded = lambda effect: (given.append(effect), events.TimerFired(at_s=1.0, timer="none"))[1]  # type: ignore[method-assign]
    cluster.give("LOAD LIFT-SCRIPT INTO ELABORATOR")
    for _ in range(20):
        cluster.tick()
    cluster._handle(events.BrokerRestarted(at_s=cluster.now_s))
    cluster.tick()
    assert [(one.name, one.attempt) for one in given] == [("LIFT-SCRIPT", 1), ("LIFT-SCRIPT", 2)]

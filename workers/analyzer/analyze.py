"""Analyzer worker function: (program, expected result, end report) -> continue, trim or abort, with world changes.

Evaluate, then trim (paper, Figure 3). A step succeeds if it expects the stop reason and its post-conditions hold. Any
other end is a failure of the class that the program's table names. The first applicable trim that this step has not
used may correct it; `trimmers` chooses. Memoryless: it uses only this report and its context, no other command (R139).
"""

from __future__ import annotations

import msgspec

from rtc.programs import named_algorithms
from rtc.programs.compatibility import row_of
from rtc.programs.loader import decode
from rtc.programs.schema import AnalyzerProgram, OutcomeClass
from rtc.protocol.advice import sentences_of
from rtc.protocol.messages import AnalyzerInput, Assessment, Binding, EndReport, Validity
from rtc.protocol.outcomes import ProgramError, Refusal, RefusalReason, Refused, StopReason
from rtc.protocol.spelling import unknown
from rtc.world.model import World
from workers.analyzer import comparison, reported_facts, trimmers, what_is_left
from workers.analyzer.failure_advice import what_clears
from workers.analyzer.failure_words import what_happened
from workers.analyzer.held_object import held_object_changes, moved_in_hand, with_spread
from workers.analyzer.post_conditions import UNMET, squeezed, unmoved_joint, violated
from workers.analyzer.step_changes import (
    arm_changes,
    merged,
    nearby_changes,
    partner_changes,
    pressed_on,
    target_changes,
    touched_object_changes,
)
from workers.conditions import installed_phases, reflexes
from workers.mechanisms import each, joined, refuse_missing
from workers.planning import in_seat, shared_hold, trust
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery
from workers.tasks.analyze_task import AnalyzeTask, Changes

INPUT = AnalyzerInput
NEEDS_WORLD = True
NEEDS_CELL = True

#: measured values that `keep` of a step may name
SOURCES = {"report.trip_pose", "report.pose", "report.hand_width"}
#: stop reasons of a hand that pressed on something: this may turn a held object between the fingers
PRESSED = frozenset(
    {
        *(StopReason.CONTACT, StopReason.COLLISION, StopReason.ARM_CONTACT, StopReason.FORCE_LIMIT),
        *(StopReason.TORQUE_LIMIT, StopReason.FOLLOWING_ERROR, StopReason.SLIP),
    }
)

#: those of them that the torque of a bolt causes: it turns a driver in the hand, and does not press it aside
WRUNG = frozenset({StopReason.CONTACT, StopReason.TORQUE_LIMIT, StopReason.SLIP})

#: effect of a step -> its changes of the world, and those of its failure
EFFECTS = joined(lambda mechanism: mechanism.effects)
AFTER_FAILURE = joined(lambda mechanism: mechanism.after_failure)
INTERRUPTED = joined(lambda mechanism: mechanism.interrupted)
DERIVED = each(lambda mechanism: mechanism.derived)

FOUND = joined(lambda mechanism: mechanism.found)

#: figures that the program must define
VALUES = (
    *("position_m", "angle_rad", "opened_m", "touched_n", "pressing_n", "reach_m"),
    *("seated_m", "seated_rad", "in_hand_m", "misplaced_m", "misplaced_rad"),
    *("struck_n", "struck_m", "struck_rad", "twisted_n", "twisted_rad", "pressed_m", "pressed_rad"),
    *(
        "tilted_m",
        "swings_s",
        "unforeseen_m",
        "rolled_m",
        "pad_m",
        "engaged_m",
    ),
    *comparison.VALUES,
)
#: figures of the cell, which the elaborator and the binder use too; in this program they would have no effect there
OF_CELL = {"creep_m_s", "creep_rad_s", "stated_m", "stated_rad"}


def compile(program: bytes) -> AnalyzerProgram:
    """Check the program. Raises ProgramError."""
    document = decode(program, AnalyzerProgram)
    for name in VALUES:
        if name not in document.values:
            raise ProgramError(f"$.values: no {name}")
    for name in OF_CELL & document.values.keys():
        raise ProgramError(f"$.values.{name}: it is one of the cell's `numbers`; state it there")
    named_algorithms.refuse_missing(document)
    refuse_missing(document)
    return document


def run(
    compiled: AnalyzerProgram, cell: CellModel | None, world: World | None, data: AnalyzerInput
) -> Assessment | Refusal:
    """Evaluate an end report."""
    assert cell is not None
    assert world is not None
    try:
        assessed = _assessed(AnalyzeTask(compiled, WorldQuery(cell, world), data))
        return installed_phases.applied(compiled.phases, data, assessed)
    except Refused as refused:
        return refused.refusal


def _assessed(task: AnalyzeTask) -> Assessment:
    """The verdict on the report. Raises Refused if the program lacks the row of the step."""
    row, report = row_of(task.step), task.report
    if row not in task.program.outcomes:
        message = unknown("row of the analyzer's outcomes", row, task.program.outcomes)
        raise Refused.because(RefusalReason.PROGRAM, message, where=row, clears="LOAD a program that has it")
    wrong = violated(task)
    if not wrong and report.reason in task.step.expect:
        return _success(task)
    reason = task.program.derived.get(row, {}).get(wrong, report.reason)
    if still := unmoved_joint(task):
        reason = StopReason.FOLLOWING_ERROR
        words = f"{still} of {task.evaluation.arm} has not moved while others have; {report.message}".rstrip("; ")
        report = msgspec.structs.replace(report, message=words)
        task = AnalyzeTask(task.program, task.query, msgspec.structs.replace(task.data, report=report))
    cells = task.program.outcomes[row]
    behind = task.program.unmet if wrong == UNMET else task.program.squeezed if squeezed(task) else ""
    # An answer of the operator to what another subsystem performs: it was stopped.
    name = behind or cells.get(reason, cells[StopReason.HALT])
    return _failure(task, reason, name)


def _success(task: AnalyzeTask) -> Assessment:
    """The step has ended as expected: its effect on the world, the values that it keeps, and what has drifted."""
    changes = _success_changes(task)
    found = comparison.compared(task, changes)
    drifts = [figure for figure in found.figures if figure.drifts] if found else []
    of_grip = any(figure.name in comparison.GRIP for figure in drifts)
    trim = _trim_of_grip(task) if of_grip else 0
    drift = comparison.in_words(drifts)
    if of_grip and not trim:
        cure = trust.remedy(task.query, f"{task.evaluation.held}.grasp", task.program.clears)
        drift += f"; {', then '.join(sentences_of(cure[:1]))}"
    return Assessment(
        verdict="abort" if task.data.closing else "trim" if trim else "continue",
        reason=task.report.reason,
        message=task.step.label,
        found="; ".join(filter(None, (task.evaluation.remark, *_found(task)[:1]))),
        trim=trim,
        keep={name: _kept(source, task.report) for name, source in task.step.keep.items()},
        remark=_remark(task),
        changes=changes,
        compared=found,
        drift=drift,
    )


def _trim_of_grip(task: AnalyzeTask) -> int:
    """The entry that grips again before the object is lost (R146); 0 if the script has none, or it was used."""
    entry = task.context.if_drifting
    return 0 if task.data.closing or entry in task.data.trims_used else entry


def _success_changes(task: AnalyzeTask) -> Changes:
    changes = arm_changes(task) + partner_changes(task)
    changes += reported_facts.changes_from(task.report.facts, task.query, task.values)
    effect = task.step.effect
    if effect:
        if effect not in EFFECTS:
            raise Refused.because(RefusalReason.PROGRAM, unknown("effect", effect, EFFECTS), where=task.step.label)
        changes += EFFECTS[effect](task, Validity.VALID)
    changes += held_object_changes(task, changes, suspect=False)
    changes += pressed_on(task)
    return _with_derived(task, with_spread(task, merged(changes)))


def _with_derived(task: AnalyzeTask, changes: Changes) -> Changes:
    return [*changes, *(one for derived in DERIVED for one in derived(task.query, changes))]


def _remark(task: AnalyzeTask) -> str:
    """What the outcome of a command states after this step: an answer, that a body was seen but may not be there, or
    how far the object is from free of the seat that it leaves."""
    if task.step.says:
        return "; ".join(filter(None, (task.step.says, task.evaluation.remark)))
    if found := _found(task):
        return found[1]
    leaves = task.step.leaves_seat
    return in_seat.remark_on_slot(task.query, task.evaluation.arm, task.report.tcp_pose) if leaves else ""


def _found(task: AnalyzeTask) -> tuple[str, ...]:
    """What a mechanism says of this step: (what was found, what the outcome of the command states); empty: nothing."""
    found = FOUND.get(task.step.effect)
    return found(task) if found is not None else ()


def _swinging(task: AnalyzeTask, reason: StopReason) -> str:
    """That what a halted arm holds is not at rest when the arm is, and for how long."""
    held = task.evaluation.held if reason is StopReason.HALT and task.report.duration_s > 0.0 else ""
    return f"{held} may swing for {task.values['swings_s']:g} s more" if held else ""


def _all_done(task: AnalyzeTask, reason: StopReason) -> str:
    """That a halt came after the whole amount of a relative sentence: to give it again would do more."""
    return what_is_left.nothing(task) if reason is StopReason.HALT and task.report.joints else ""


def _kept(source: str, report: EndReport) -> Binding:
    """A measured value as a binding. Poses are in the world frame: a contact position does not depend on facts."""
    if source == "report.hand_width":
        return Binding(number=report.hand_width_m)
    assert source in SOURCES, source
    tripped = report.trip_pose if source == "report.trip_pose" else None
    return Binding(pose=tripped or report.tcp_pose)


def _failure(task: AnalyzeTask, reason: StopReason, name: str) -> Assessment:
    """The step has ended otherwise: what may have changed, a trim that may correct it, and else what clears it.
    `name`: of the failure class."""
    failure = task.program.classes[name]
    may = failure.retriable and not task.data.closing
    trims, choice = trimmers.chosen(task, reason, name) if may else ([], "")
    pressed = not trims and reason in PRESSED and (task.report.turned_rad is None or reason not in WRUNG)
    changes = moved_in_hand(task, _failure_changes(task, failure, retried=bool(trims)), failure, pressed=pressed)
    asked = reflexes.find_requested(task.context.reflexes, task.report)
    clears = what_clears(task, reason, failure, changes, asked=asked is not None, pressed=pressed)
    return Assessment(
        verdict="trim" if trims else "abort",
        reason=reason,
        message=f"{task.step.label}: {what_happened(task, reason, failure, asked)}{choice}",
        trim=trims[0] if trims else 0,
        further=trims[1:],
        changes=changes,
        clears=clears,
        remark="; ".join(filter(None, (_swinging(task, reason), _all_done(task, reason)))),
        by_operator=shared_hold.offer(task.query, task.context) if may else "",
        compared=comparison.unexpected(task),
    )


def _failure_changes(task: AnalyzeTask, failure: OutcomeClass, *, retried: bool) -> Changes:
    """What the report states, and what is in doubt after a failure of this class."""
    changes = arm_changes(task) + partner_changes(task)
    if (interrupted := INTERRUPTED.get(task.step.effect)) is not None:
        changes += interrupted(task)
    changes += held_object_changes(task, changes, suspect="held" in failure.suspect, drops=failure.drops)
    changes += touched_object_changes(task, failure)
    changes += nearby_changes(task) if "near" in failure.suspect else []
    changes += target_changes(task) if "target" in failure.suspect else []
    if (of_mechanism := AFTER_FAILURE.get(task.step.effect)) is not None:
        changes += of_mechanism(task, retried)
    missed = task.step.missed
    may_retry = failure.retriable and not task.data.closing and not task.data.trims_used
    if missed in EFFECTS and may_retry:
        changes += EFFECTS[missed](task, Validity.SUSPECT)
    return _with_derived(task, with_spread(task, merged(changes)))

"""The nominal path of a command from its plan to its success: elaborated, bound, executed, assessed. Pure.

The actions know steps and primitives as opaque bytes. They do not know skills, geometry or sockets.
"""

from __future__ import annotations

import msgspec

from broker.decisions.command.claims import claim_or_wait
from broker.decisions.command.closing import close
from broker.decisions.command.limits import await_report
from broker.decisions.command.pacing import send_pace
from broker.decisions.command.termination import end, end_given_up, refuse
from broker.decisions.context import DecisionContext, step_in_words
from broker.decisions.effects import AcknowledgeReport, SendPrimitive
from broker.decisions.events import Stimulus
from broker.decisions.resources import Claim
from broker.decisions.state import (
    NIL,
    AssessmentHead,
    BoundHead,
    Command,
    LinkState,
    PendingOutcome,
    ScriptHead,
    SubsystemState,
    picture_times_of,
    queues_of,
)
from rtc.programs import action_stack
from rtc.programs.action_stack import NOMINAL
from rtc.protocol import wire
from rtc.protocol.messages import Assessment, Breakpoint, EndReport, NoteKind, Phase, WorkerKind
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason, StopReason
from rtc.protocol.primitive import Primitive, TeleopMotion
from rtc.protocol.primitive_id import belongs_to, command_of, primitive_id

read_script = wire.decoder(ScriptHead)
read_bound = wire.decoder(BoundHead)
read_primitive = wire.decoder(Primitive)  # read completely, so that a subsystem never receives an invalid primitive


def on_elaborated(context: DecisionContext, command: Command, product: msgspec.Raw) -> None:
    script = read_script(product)
    queues = queues_of(context.state)
    claim: Claim = dict.fromkeys(script.reads, False)
    claim.update({name: name not in queues for name in script.resources})
    claim.update(dict.fromkeys(script.writes, True))
    halted = [r for r in script.resources if context.state.halted_at_s.get(r, -1.0) > command.given_at_s]
    if halted:
        message = f"{halted[0]} was halted after this command was given"
        end(context, command, PendingOutcome(OutcomeKind.HALTED, message, StopReason.HALT))
        return
    if not claim_or_wait(context, command, claim):
        return
    command.actions = action_stack.begin(script)
    if script.notes:
        context.note(command, NoteKind.PLANNED, message="; ".join(script.notes))
    next_step(context, command)


def next_step(context: DecisionContext, command: Command, remark: str = "") -> None:
    """Bind the top of the Action_Stack, or end the command if the stack is empty (paper, main loop). `remark`: of the
    step before, for the outcome."""
    actions = command.actions
    assert actions is not None
    if not actions.refs and command.given_up is not None:
        end_given_up(context, command)
    elif not actions.refs:
        end(context, command, PendingOutcome(OutcomeKind.SUCCEEDED, remark))
    elif command.pause_wanted or command.single_step:
        context.enter(command, Phase.PAUSED, NoteKind.PAUSED)
    elif context.state.breakpoints and (breakpoint := _breakpoint(command)) in context.state.breakpoints:
        clears = [f"RESUME {command.id}"]
        context.enter(command, Phase.PAUSED, NoteKind.BREAKPOINT, about=str(breakpoint), clears=clears)
    else:
        take_step(context, command)


def _breakpoint(command: Command) -> Breakpoint:
    """The place before the next step; step 0, where no breakpoint is, before one of a trim."""
    assert command.actions is not None
    assert command.head is not None
    trim, index = command.actions.refs[-1]
    return Breakpoint(command.head.verb, index + 1 if trim == NOMINAL else 0)


def take_step(context: DecisionContext, command: Command) -> None:
    """Bind the step on the top of the Action_Stack, which is not empty."""
    assert command.actions is not None
    command.actions.pop()
    command.step_text, command.starts_after = step_in_words(command.actions), ""
    bind_step(context, command)


def bind_step(context: DecisionContext, command: Command, kind: NoteKind = NoteKind.PHASE, message: str = "") -> None:
    """Bind the current step; a wanted pause comes first. `kind`, `message`: of the note, why it is bound again."""
    actions = command.actions
    assert actions is not None
    if command.pause_wanted:
        actions.put_back()
        context.enter(command, Phase.PAUSED, NoteKind.PAUSED)
        return
    name = primitive_id(command.id, command.primitives + 1, context.state.life)
    others = len(context.state.commands) > 1
    moving, pictures = context.motions_beside(command), picture_times_of(context.state)
    data = msgspec.structs.replace(actions.binder_input(name), others=others, pictures=pictures, moving=moving)
    context.create_job(command, WorkerKind.BINDER, data)
    context.enter(command, Phase.BINDING, kind, message=message)


def on_bound(context: DecisionContext, command: Command, product: msgspec.Raw) -> None:
    """Continue with what the binder made of the step: a primitive, a report at once, or bindings alone."""
    assert command.actions is not None
    result = read_bound(product)
    command.actions.assign(result.bindings)
    if result.report != NIL:
        command.evaluation = result.evaluation
        analyze(context, command, result.report)
        context.enter(command, Phase.ANALYZING, NoteKind.BOUND, message=result.note)
        return
    if not result.subsystem or result.primitive == NIL:
        command.steps_done += 1
        context.note(command, NoteKind.ASSIGNED, message=result.note)
        next_step(context, command)
        return
    subsystem = context.state.subsystems.get(result.subsystem)
    if subsystem is None or subsystem.link is LinkState.LOST:
        lost = f"{result.subsystem} is not connected; this step moved nothing: give the sentence again when it is back"
        end(context, command, PendingOutcome(OutcomeKind.LOST_SUBSYSTEM, lost, StopReason.SUBSYSTEM_LOST))
        return
    primitive = read_primitive(result.primitive)
    if message := _fault(context, command, result, primitive, subsystem):
        refuse(context, command, Refusal(reason=RefusalReason.PROGRAM, message=message, where=command.step_words))
    elif primitive.paths and not context.is_clear(command, primitive.space_mm):
        bind_step(context, command, NoteKind.MOTIONS_CHANGED)
    else:
        begin(context, command, result, primitive)


def _fault(
    context: DecisionContext, command: Command, result: BoundHead, primitive: Primitive, subsystem: SubsystemState
) -> str:
    """Why the primitive that the binder made may not be sent; empty if it may."""
    held = context.state.resources.held.get(command.id, {})
    queues = subsystem.queues
    unclaimed = next((p for p in primitive.performers if not (held.get(p) or (p in held and p in queues))), "")
    if unclaimed:
        return f"the step moves {unclaimed}, which its script has not claimed"
    if not belongs_to(primitive.id, command.id, command.primitives + 1, context.state.life):
        return f"the binder made a primitive called {primitive.id[:40]!r}, which is not the next one of {command.id}"
    return "" if result.evaluation != NIL else "the binder made a primitive without an evaluation for the analyzer"


def begin(context: DecisionContext, command: Command, result: BoundHead, primitive: Primitive) -> None:
    """Send a primitive that was accepted. The command executes it from now on."""
    command.primitives += 1
    command.primitive = primitive.id
    command.primitive_body = result.primitive
    command.performers = (*primitive.performers,)
    command.subsystem = result.subsystem
    command.operated = isinstance(primitive.trajectory, TeleopMotion)
    command.evaluation = result.evaluation
    command.limit_s = result.limit_s
    for arm in primitive.paths:
        context.begin_motion(command, arm, result.primitive, primitive.space_mm)
    if result.remark:
        command.step_text += f" ({result.remark})"
    command.starts_after = ", ".join(dict.fromkeys(command_of(one.primitive) for one in primitive.start_after))
    send(context, command)
    expected_s = 0.0 if command.operated else result.predicted_s * context.state.timeout_scale  # of a person: unknown
    context.enter(
        command,
        Phase.EXECUTING,
        NoteKind.BOUND,
        message=result.note,
        expected_s=expected_s,
        owner=command.starts_after,
    )
    if command.primitives == 1:
        for waiting in context.state.joining.pop(command.id, ()):
            context.enqueue_stimulus(waiting, Stimulus.RELEASE, True)


def send(context: DecisionContext, command: Command) -> None:
    """Send the primitive to its subsystem, which is responsible for it from now on (R58); the broker watches the time
    limit only. An awaited subsystem receives it when it reconnects."""
    command.sent_at_s = context.now
    command.at_rest = False
    subsystem = context.state.subsystems[command.subsystem]
    if subsystem.link is LinkState.CONNECTED:
        context.effects.append(
            SendPrimitive(
                subsystem=command.subsystem,
                id=command.primitive,
                primitive=command.primitive_body,
                pid=subsystem.pid,
            )
        )
        if command.pause_wanted:
            send_pace(context, command)
    await_report(context, command)


def on_reported(context: DecisionContext, command: Command, report: EndReport) -> None:
    context.stop_timer(command)
    acknowledge(context, command)
    if command.actions is not None:
        command.actions.moved_s += report.duration_s
    command.measured = report.reading or command.measured
    if report.reason is StopReason.HALT:
        command.pending_outcome = PendingOutcome(OutcomeKind.HALTED, "halted at its subsystem", StopReason.HALT)
        close(context, command, report, NoteKind.STEP_ENDED, reason=report.reason, message=report.message)
        return
    analyze(context, command, report)
    kind, reason, message = NoteKind.STEP_ENDED, report.reason, report.message
    context.enter(command, Phase.ANALYZING, kind, reason=reason, message=message, measured=command.measured)


def acknowledge(context: DecisionContext, command: Command) -> None:
    """Acknowledge the end report. Effects follow the journal, so the report is not needed again."""
    context.effects.append(AcknowledgeReport(subsystem=command.subsystem, primitive=command.primitive))
    command.primitive_body = NIL
    command.at_rest = True


def analyze(context: DecisionContext, command: Command, report: EndReport | msgspec.Raw) -> None:
    assert command.actions is not None
    data = command.actions.analyzer_input(command.evaluation, report)
    context.create_job(command, WorkerKind.ANALYZER, data, locations=command.actions.script.writes)


def on_assessed(context: DecisionContext, command: Command, assessment: AssessmentHead) -> None:
    assert command.actions is not None
    command.actions.assign(assessment.keep)
    context.end_motions(command)
    if assessment.verdict == "continue":
        command.steps_done += 1
        _note_judged(context, command, assessment)
        next_step(context, command, assessment.remark)
    elif assessment.verdict == "trim" and push_trim(context, command, assessment):
        next_step(context, command)
    elif command.given_up is not None:
        end_given_up(context, command, assessment.message)
    else:
        end(context, command, failure(assessment), compared=assessment.compared)


def failure(assessment: AssessmentHead | Assessment) -> PendingOutcome:
    """The outcome after a step without a usable trim."""
    stated = "; ".join(filter(None, (assessment.message, assessment.found)))
    message = stated or f"{assessment.reason.value} where it was not expected"
    refusal = None
    if assessment.clears or assessment.by_operator:
        refusal = Refusal(reason=RefusalReason.STATE, message=message, clears=assessment.clears)
        refusal = refusal.offering(assessment.by_operator)
    return PendingOutcome(kind=OutcomeKind.FAILED, message=message, stop=assessment.reason, refusal=refusal)


def push_trim(context: DecisionContext, command: Command, assessment: AssessmentHead) -> bool:
    """Continue with the steps of the trim that the analyzer proposes. False: the trim is not allowed."""
    assert command.actions is not None
    trim = command.actions.push_trim(assessment.trim, assessment.further)
    if trim is None:
        return False
    context.count("trims")
    if trim.then == "give_up":
        command.given_up = failure(assessment)
    pieces = [command.actions.trim(n).label for n in (assessment.trim, *assessment.further)]
    _note_judged(context, command, assessment, pieces)
    return True


def _note_judged(
    context: DecisionContext, command: Command, assessment: AssessmentHead, pieces: list[str] | None = None
) -> None:
    """Note the verdict; `pieces`: of its trim. What has drifted is a warning: a person may act before a step fails."""
    context.note(
        command,
        NoteKind.JUDGED if pieces is None else NoteKind.TRIM,
        reason=assessment.reason,
        message=assessment.message,
        found=assessment.found,
        drift=assessment.drift,
        compared=assessment.compared,
        trim=0 if pieces is None else assessment.trim,
        pieces=pieces or [],
        warning=bool(assessment.drift),
    )

"""The Decision Unit: `decide(state, event) -> effects`, the pure state machine that every command passes through.

Rule 1: it uses no clock, socket, log, random number or setting; the time is a field of the event. The same events give
the same state and effects, so a restart needs only the journal of events.
Rule 2: every machine runs from a table (`broker.decisions.machine`); the transitions are checked after every action.
Rule 3: `state` is changed in place, by `decide` alone.

A result of a cancelled job, or of an older attempt, is stale: it is counted and has no other effect. The same holds for
every empty cell of the table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from broker.decisions import (
    deferred_analysis,
    faults,
    halt_request,
    journal_loss,
    parsed_before,
    program_rollout,
    subsystem_link,
)
from broker.decisions.command import control, intake, limits, operator_answers, pacing, stopping, termination
from broker.decisions.command.table import stimulate
from broker.decisions.context import DecisionContext
from broker.decisions.effects import AcknowledgeReport, Effect, TellClient
from broker.decisions.events import (
    AnswerWasRefused,
    ArmStrayed,
    BreakpointsChanged,
    BrokerRestarted,
    ClientGone,
    CommandReceived,
    Event,
    HaltCalled,
    HaltConfirmed,
    JobDeclined,
    JobFinished,
    JobLost,
    JournalLost,
    ListenersChanged,
    PrimitiveEnded,
    PrimitivePaced,
    PrimitiveStarted,
    ProgramInstalled,
    StepRequested,
    Stimulus,
    SubsystemConnected,
    SubsystemGone,
    TimerFired,
)
from broker.decisions.state import Command, PendingJob, PendingOutcome, State, request_key
from rtc.language.fastpath import halt_scope
from rtc.protocol.advice import by_person
from rtc.protocol.messages import Accepted, Declined, HaltOrder, NoteKind, ParserInput, Phase, WorkerKind
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason, StopReason, WireError
from rtc.protocol.primitive_id import command_of

MAX_COMMANDS = 10_000  # maximum number of live commands; more are declined
LIVE_PER_CLIENT = 2_000  # maximum per client, so that one client cannot use up MAX_COMMANDS
MAX_TEXT = 4_000  # characters kept of a sentence; the parser refuses shorter ones already and names the place
# A constant, because Python 3.11 takes as long to find a member of an enumeration as to call a function.
PRODUCT, PARSER = Stimulus.PRODUCT, WorkerKind.PARSER
CLIENTS_KEPT = 1024  # clients whose latest command is stored, for AFTER LAST


def decide(state: State, event: Event) -> list[Effect]:
    """Handle one event: change `state` and return the effects in the order of execution."""
    return decide_batch(state, (event,))


def decide_batch(state: State, events: Iterable[Event]) -> list[Effect]:
    """Handle the events of one batch in order; all their effects, in the order of execution."""
    effects: list[Effect] = []
    context = DecisionContext(state, 0.0)
    for event in events:
        context.now, context.effects, context.node, context.took_s = event.at_s, [], "", 0
        HANDLERS[type(event)](context, event)
        if context.followups:
            _follow(context)
        effects += context.effects
    return effects


def _follow(context: DecisionContext) -> None:
    """Stimulate the other commands that the actions of this event named. These actions may name more."""
    for name, stimulus, payload in context.followups:  # it grows during the loop
        context.node, context.took_s = "", 0
        command = context.state.commands.get(name)
        if command is not None:
            stimulate(context, command, stimulus, payload)
    context.followups = []


# --- clients -----------------------------------------------------------------------------------------


def on_command(context: DecisionContext, event: CommandReceived) -> None:
    """Accept a sentence and begin with it, or decline it. A request that is known is answered as before."""
    state, sentence = context.state, event.sentence
    halt = halt_scope(sentence.text)
    key = request_key(event.client, sentence.request)
    if known := state.requests.get(key):
        accepted = Accepted(request=sentence.request, command=known)
        context.effects.append(TellClient(client=event.client, message=accepted))
        if known in state.ended:
            context.effects.append(TellClient(client=event.client, message=state.ended[known].message))
        return
    lost = not halt and journal_loss.is_lost(state, sentence)
    if not lost and (refusal := _refusal_of(context, event, halt)):
        declined = Declined(request=sentence.request, refusal=refusal)
        context.effects.append(TellClient(client=event.client, message=declined))
        return
    command = _accept(context, event)
    state.requests[key] = command.id
    if lost:
        journal_loss.end_lost(context, command)
    elif halt:
        control.halt_sentence(context, command, halt)
    elif 0 < sentence.sent_at_s <= state.halted_at_s.get("ALL", 0.0):
        message = "sent before HALT ALL, so it does not start after it"
        termination.end(context, command, PendingOutcome(OutcomeKind.HALTED, message, StopReason.HALT))
    else:
        state.intake_order.setdefault(command.client, {})[command.id] = False
        _parse(context, command)


def _parse(context: DecisionContext, command: Command) -> None:
    """Let a parser read the sentence, or use what the same program has made of the same words before."""
    known = parsed_before.find(context.state, command)
    if known is None:
        context.create_job(command, WorkerKind.PARSER, ParserInput(text=command.text))
        context.enter(command, Phase.PARSING)
        return
    command.jobs += 1  # so that the later jobs have the same ids in either case
    context.count("parsed_before")
    context.enter(command, Phase.PARSING, NoteKind.PARSED_BEFORE)
    stimulate(context, command, Stimulus.PRODUCT, known)


def _refusal_of(context: DecisionContext, event: CommandReceived, halt: str | None) -> Refusal | None:
    """Why a sentence is declined; None if it is not. `halt`: the scope of a halt, which is obeyed nevertheless."""
    state = context.state
    if not halt and (refusal := journal_loss.unknown_number(state, event.sentence)):
        return refusal
    live = state.live.get(event.client, 0)
    if live < LIVE_PER_CLIENT and len(state.commands) < MAX_COMMANDS:
        return None
    context.count("declined")
    message = f"{len(state.commands)} commands are live, {live} of them yours; the limit is " + (
        f"{LIVE_PER_CLIENT} of one client" if live >= LIVE_PER_CLIENT else f"{MAX_COMMANDS} in all"
    )
    if halt:
        count = state.counts["declined"]
        halt_request.order(context, HaltOrder(halt=f"declined-{count}", scope=halt, called_at_s=context.now))
        message = f"{halt} is halted, but rest is not confirmed: {message}"
    return Refusal(reason=RefusalReason.OVERLOAD, message=message, clears=by_person("wait until some have ended"))


def _accept(context: DecisionContext, event: CommandReceived) -> Command:
    """The command of a sentence, with its number, which its client is informed of."""
    state, sentence = context.state, event.sentence
    command = Command(
        id=journal_loss.new_number(state, sentence),
        client=event.client,
        request=sentence.request,
        text=sentence.text[:MAX_TEXT],
        source=sentence.source,
        progress=sentence.progress,
        unwatched=state.crowded,
        halt_if_lost=sentence.halt_if_lost,
        accepted_at_s=event.at_s,
        given_at_s=min(sentence.sent_at_s or event.at_s, event.at_s),
        programs=dict(state.programs),
        saved=sentence.saved,
        previous=state.last_given.get(event.client, ""),
        after_test=sentence.after_test,
        label=sentence.label,
        if_tested=sentence.if_tested,
    )
    if intake.may_be_last(sentence.text):
        state.last_given.pop(event.client, None)
        state.last_given[event.client] = command.id  # the latest client last
    if len(state.last_given) > CLIENTS_KEPT:
        del state.last_given[next(iter(state.last_given))]
    if state.crowded:
        context.count("unwatched")
    state.commands[command.id] = command
    state.live[event.client] = state.live.get(event.client, 0) + 1
    accepted = Accepted(request=sentence.request, command=command.id)
    context.effects.append(TellClient(client=event.client, message=accepted))
    return command


def on_client_gone(context: DecisionContext, event: ClientGone) -> None:
    gone = PendingOutcome(kind=OutcomeKind.HALTED, message="its client disconnected", stop=StopReason.HALT)
    for command in context.state.commands.values():
        if command.client == event.client and command.halt_if_lost:
            context.enqueue_stimulus(command.id, Stimulus.STOP, gone)


def on_breakpoints(context: DecisionContext, event: BreakpointsChanged) -> None:
    context.state.breakpoints = event.breakpoints


def on_step_requested(context: DecisionContext, event: StepRequested) -> None:
    context.enqueue_stimulus(event.command, Stimulus.STEP)


# --- workers -----------------------------------------------------------------------------------------


def _pending(context: DecisionContext, event: JobFinished | JobDeclined | JobLost) -> tuple[Command, PendingJob] | None:
    """The command that waits for this attempt of the job.

    None if a deferred analysis waits for it, which is handled here, or if the answer is stale, which is counted.
    """
    state = context.state
    if state.deferred_analyses and deferred_analysis.handle_answer(context, event):
        return None
    command = state.commands.get(event.job.partition("/")[0])
    pending = command.job if command is not None else None
    if command is None or pending is None or pending.id != event.job or pending.attempt != event.attempt:
        context.count("stale")
        return None
    context.node, context.took_s = event.node, event.at_s - pending.since_s
    return command, pending


def on_job_finished(context: DecisionContext, event: JobFinished) -> None:
    if (found := _pending(context, event)) is None:
        return
    command, job = found
    command.job = None
    program_rollout.on_job_done(context, job)
    try:
        stimulate(context, command, PRODUCT, event.product)
        if job.worker is PARSER:
            parsed_before.keep(context.state, job.program, command.text, event.product)
    except WireError as error:
        message = f"the {job.worker.value} returned an invalid product: {error}"
        stimulate(context, command, Stimulus.REFUSAL, Refusal(reason=RefusalReason.PROGRAM, message=message))


def on_job_declined(context: DecisionContext, event: JobDeclined) -> None:
    if (found := _pending(context, event)) is None:
        return
    command, job = found
    if event.refusal.reason is RefusalReason.TIMEOUT:
        stimulate(context, command, Stimulus.UNAVAILABLE, event.refusal)
        return
    if event.refusal.reason is RefusalReason.PROGRAM and program_rollout.repeat_with_another(
        context, command, job, event.refusal.message
    ):
        return
    stimulate(context, command, Stimulus.REFUSAL, event.refusal)


def on_job_lost(context: DecisionContext, event: JobLost) -> None:
    if (found := _pending(context, event)) is None:
        return
    command, job = found
    if event.blamed and program_rollout.repeat_with_another(context, command, job, event.evidence):
        return
    stimulate(context, command, Stimulus.WORKER_LOST, event)


# --- subsystems --------------------------------------------------------------------------------------


def on_started(context: DecisionContext, event: PrimitiveStarted) -> None:
    primitive = event.start.primitive
    command = context.state.commands.get(command_of(primitive))
    awaited = command is not None and (command.primitive, command.subsystem) == (primitive, event.subsystem)
    if awaited and command is not None and command.phase is Phase.EXECUTING:
        context.node = event.subsystem
        command.starts_after = ""
        for motion in context.state.motions.values():
            if motion.primitive == primitive:
                motion.started_s = context.now
        context.note(command, NoteKind.STARTED)


def on_ended(context: DecisionContext, event: PrimitiveEnded) -> None:
    report = event.report
    if report.pictures and (subsystem := context.state.subsystems.get(event.subsystem)) is not None:
        subsystem.pictures = report.pictures
    command = context.state.commands.get(command_of(report.primitive))
    awaited = (
        command is not None
        and command.primitive == report.primitive
        and command.subsystem == event.subsystem
        and command.phase in (Phase.EXECUTING, Phase.HALTING)
    )
    if not awaited or command is None:
        # Late or duplicate. It is acknowledged, or it would be repeated without end. It also proves rest.
        context.count("stale")
        context.effects.append(AcknowledgeReport(subsystem=event.subsystem, primitive=report.primitive))
        if command is None or command.primitive == report.primitive:
            context.confirm_rest(event.subsystem, [], moved=report.primitive)
        return
    context.node, context.took_s = event.subsystem, event.at_s - command.sent_at_s
    stimulate(context, command, Stimulus.REPORT, report)
    operator_answers.on_reported(context, report)
    faults.stop_others(context, command, report)


def on_halt_confirmed(context: DecisionContext, event: HaltConfirmed) -> None:
    """Handle the answer to a halt: of a command's primitive, of a HALT sentence, or of a caller at a socket."""
    state, answer = context.state, event.answer
    context.node = answer.subsystem
    stopped = answer.halt.removeprefix(stopping.STOP)
    owner = "" if stopped == answer.halt else stopped
    if answer.at_rest:
        context.confirm_rest(answer.subsystem, answer.performers, owner)
    if answer.halt in state.halt_sentences:
        halt_request.on_confirmed(context, answer.halt, answer.subsystem, answer.at_rest)
    command = state.commands.get(owner)
    if command is not None and command.subsystem == answer.subsystem and answer.at_rest:
        stimulate(context, command, Stimulus.REST)


def on_listeners(context: DecisionContext, event: ListenersChanged) -> None:
    if event.listening and not context.state.has_subscribers:
        journal_loss.publish(context)
    context.state.has_subscribers, context.state.crowded = event.listening, event.crowded


# --- time and restart --------------------------------------------------------------------------------


def on_timer(context: DecisionContext, event: TimerFired) -> None:
    if deferred_analysis.handle_timer(context, event.timer):
        return
    command = context.state.commands.get(event.timer)
    if command is None or not 0 < command.due_s <= event.at_s:
        context.count("stale")  # stopped or restarted in the batch in which it fired
        return
    command.due_s = 0.0
    if event.timer in context.state.halt_sentences:
        halt_request.on_timeout(context, event.timer)
    else:
        stimulate(context, command, Stimulus.TIMEOUT)


def on_restart(context: DecisionContext, event: BrokerRestarted) -> None:
    """Dispatch all pending jobs again and wait for the subsystems, which continue by themselves."""
    context.count("broker_restarts")
    context.state.has_subscribers = context.state.crowded = False  # subscribers subscribe again
    subsystem_link.on_broker_restarted(context, event)
    deferred_analysis.on_broker_restarted(context, event)
    for command in context.state.commands.values():
        if command.job is not None:
            command.job.attempt += 1
            context.dispatch_again(command)
        if command.phase is Phase.ANALYZING:
            command.due_s = 0.0  # its retry was dispatched above
        if command.phase is Phase.EXECUTING:
            limits.await_report(context, command)
        elif command.phase is Phase.HALTING:
            subsystems = [command.subsystem] if command.subsystem else list(context.state.subsystems)
            limits.await_rest(context, command, subsystems, reconnecting=True)
        elif command.phase is Phase.CLOSING:
            context.start_timer(command, limits.CLOSING_LIMIT_S)


HANDLERS: dict[type[Event], Callable[[DecisionContext, Any], None]] = {
    CommandReceived: on_command,
    HaltCalled: halt_request.on_call,
    JobFinished: on_job_finished,
    JobDeclined: on_job_declined,
    JobLost: on_job_lost,
    PrimitiveStarted: on_started,
    PrimitivePaced: pacing.on_paced,
    PrimitiveEnded: on_ended,
    HaltConfirmed: on_halt_confirmed,
    ArmStrayed: faults.on_strayed,
    AnswerWasRefused: operator_answers.on_refused,
    SubsystemConnected: subsystem_link.on_hello,
    SubsystemGone: subsystem_link.on_gone,
    ClientGone: on_client_gone,
    TimerFired: on_timer,
    ProgramInstalled: program_rollout.on_installed,
    BreakpointsChanged: on_breakpoints,
    StepRequested: on_step_requested,
    ListenersChanged: on_listeners,
    BrokerRestarted: on_restart,
    JournalLost: journal_loss.on_journal_lost,
}

"""The Decision Unit: `decide(state, event) -> effects`, the one pure machine that every command passes through.

Rule 1: no clock, socket, log, random number or setting in here; the time is in the event. The same events give the
same state and effects, so a journal of events is all that a restart needs.
Rule 2: what may follow what stands in `broker.transitions`, and is checked after every action.
Rule 3: `state` is changed in place, by `decide` alone.

An answer to a job that is no longer wanted, or to an older attempt of it, is stale: counted, nothing else. The
same holds for every empty cell of the table.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from broker import ending, journey, lost, untold
from broker.effects import AcknowledgeReport, DeclineHalt, Effect, SendHalt, TellClient
from broker.events import (
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
    PrimitiveStarted,
    ProgramInstalled,
    Stimulus,
    SubsystemConnected,
    SubsystemGone,
    TimerFired,
)
from broker.state import NIL, Command, Link, PendingJob, PendingOutcome, State, Subsystem, Trial, request_key
from broker.transitions import TABLE
from broker.turn import DecisionContext
from rtc.language.fastpath import halt_scope
from rtc.messages import Accepted, Declined, Phase, WorkerKind
from rtc.outcomes import OutcomeKind, Refusal, RefusalReason, StopReason, WireError
from rtc.primitive_id import command_of, number_of

MAX_COMMANDS = 10_000  # live at once; more are declined
LIVE_PER_CLIENT = 2_000  # of one client, so that no one client can take the place of all others
MAX_TEXT = 4_000  # characters kept of a sentence (the parser refuses shorter ones, with the place)
MAX_SUBSYSTEMS = 32  # known by name, lost ones too
HALTS_KEPT = 64
PROVEN_KEPT = 16  # programs of a kind
FILES_KEPT = 64  # programs whose file is known, for `rtc status`
CLIENTS_KEPT = 1024  # whose latest command is known, for AFTER LAST


class InvalidTransition(AssertionError):
    """A bug: an action led where the table does not allow. Tells the story that led there."""

    def __init__(self, command: Command, before: Phase, stimulus: Stimulus) -> None:
        story = "\n".join(f"  {n.at_s:.3f} {n.phase.value} {n.step} {n.note}" for n in command.notes[-20:])
        super().__init__(
            f"{command.id}: {stimulus.value} in {before.value} led to {command.phase.value}, "
            f"which the table does not allow\n{story}"
        )


def decide(state: State, event: Event) -> list[Effect]:
    """What is to be done about one event. Changes `state`; effects are in the order they must happen."""
    context = DecisionContext(state, event.at_s)
    HANDLERS[type(event)](context, event)
    for name, stimulus, payload in context.followups:  # to which more are added meanwhile
        context.node, context.took_s = "", 0.0
        command = state.commands.get(name)
        if command is not None:
            stimulate(context, command, stimulus, payload)
    return context.effects


def stimulate(context: DecisionContext, command: Command, stimulus: Stimulus, payload: Any = None) -> None:
    before = command.phase
    cell = TABLE.get((before, stimulus))
    if cell is None:
        context.count("stale")
        return
    cell.action(context, command, payload)
    if command.phase not in cell.following:
        raise InvalidTransition(command, before, stimulus)
    if before is Phase.PARSING and command.phase is not Phase.PARSING:
        context.leave_intake(command)


# --- clients -----------------------------------------------------------------------------------------


def on_command(context: DecisionContext, event: CommandReceived) -> None:
    state = context.state
    key = request_key(event.client, event.request)
    if known := state.requests.get(key):
        context.effects.append(TellClient(client=event.client, message=Accepted(request=event.request, command=known)))
        if known in state.ended:
            context.effects.append(TellClient(client=event.client, message=state.ended[known].message))
        return
    if lost.is_lost(state, event) and not halt_scope(event.text):
        lost.end_lost(context, event)
        return
    live = state.live.get(event.client, 0)
    if live >= LIVE_PER_CLIENT or len(state.commands) >= MAX_COMMANDS:
        _decline(context, event, live)
        return
    command = Command(
        id=lost.new_number(state, event),
        client=event.client,
        request=event.request,
        text=event.text[:MAX_TEXT],
        source=event.source,
        progress=event.progress,
        halt_if_lost=event.halt_if_lost,
        accepted_at_s=event.at_s,
        given_at_s=min(event.sent_at_s or event.at_s, event.at_s),
        previous=state.last_given.pop(event.client, ""),
    )
    state.last_given[event.client] = command.id  # the latest client last
    if len(state.last_given) > CLIENTS_KEPT:
        del state.last_given[next(iter(state.last_given))]
    state.commands[command.id] = command
    state.live[event.client] = live + 1
    state.requests[key] = command.id
    context.effects.append(TellClient(client=event.client, message=Accepted(request=event.request, command=command.id)))
    if scope := halt_scope(event.text):
        journey.halt_by_command(context, command, scope)
    elif 0 < event.sent_at_s <= state.halted_at_s.get("ALL", 0.0):
        message = "sent before HALT ALL, so it does not start after it"
        ending.end(context, command, OutcomeKind.HALTED, message=message, stop=StopReason.HALT)
    else:
        state.intake_order.setdefault(command.client, {})[command.id] = False
        context.create_job(command, WorkerKind.PARSER, {"text": command.text})
        context.enter(command, Phase.PARSING)


def _decline(context: DecisionContext, event: CommandReceived, live: int) -> None:
    """Too many are live. A halt is obeyed all the same."""
    context.count("declined")
    message = f"{len(context.state.commands)} commands are live, {live} of them yours; the limit is " + (
        f"{LIVE_PER_CLIENT} of one client" if live >= LIVE_PER_CLIENT else f"{MAX_COMMANDS} in all"
    )
    if scope := halt_scope(event.text):
        journey.halt(context, f"declined-{context.state.counts['declined']}", scope, context.now)
        message = f"{scope} is halted, but nobody waits for rest: {message}"
    refusal = Refusal(reason=RefusalReason.OVERLOAD, message=message, clears="wait until some have ended")
    context.effects.append(TellClient(client=event.client, message=Declined(request=event.request, refusal=refusal)))


def on_halt(context: DecisionContext, event: HaltCalled) -> None:
    """Stop what is in its scope now. Whether its name was used before does not matter: two callers may count from one,
    and a button may always say the same."""
    told_by_subsystem = event.client in context.state.subsystems
    _count_halt(context, event)
    known = journey.halt(context, event.halt, event.scope, event.called_at_s, call=event.call)
    # Of a command that has ended nothing moves, as the subsystems confirm: that is no halt of nobody knows what.
    if not known and not told_by_subsystem and not journey.has_ended(context, event.scope):
        message = journey.no_target(context, event.scope).message
        context.effects.append(DeclineHalt(client=event.client, halt=event.halt, message=message))
    if told_by_subsystem and not any(type(e) is SendHalt and e.subsystem == event.client for e in context.effects):
        # It begins nothing until it hears that we know.
        context.effects.append(
            SendHalt(
                subsystem=event.client,
                halt=event.halt,
                scope=event.scope,
                called_at_s=event.called_at_s,
                call=event.call,
            )
        )


def _count_halt(context: DecisionContext, event: HaltCalled) -> None:
    """A caller uses both doors, so most halts are received twice: from the caller, and from the subsystem."""
    halts, key = context.state.halts, f"{event.halt} {event.scope} {event.called_at_s}"
    if key not in halts:
        context.count("halts")
    halts[key] = event.at_s
    if len(halts) > HALTS_KEPT:
        del halts[next(iter(halts))]


def on_client_gone(context: DecisionContext, event: ClientGone) -> None:
    gone = PendingOutcome(kind=OutcomeKind.HALTED, message="its client went away", stop=StopReason.HALT)
    for command in context.state.commands.values():
        if command.client == event.client and command.halt_if_lost:
            context.follow(command.id, Stimulus.STOP, gone)


# --- workers -----------------------------------------------------------------------------------------


def _pending(context: DecisionContext, job: str, attempt: int) -> tuple[Command, PendingJob] | None:
    """The command that waits for just this answer; None (and counted) when the answer is stale."""
    command = context.state.commands.get(job.partition("/")[0])
    if command is None or command.job is None or (command.job.id, command.job.attempt) != (job, attempt):
        context.count("stale")
        return None
    return command, command.job


def on_job_finished(context: DecisionContext, event: JobFinished) -> None:
    if untold.handle_answer(context, event) or (found := _pending(context, event.job, event.attempt)) is None:
        return
    command, job = found
    context.node, context.took_s = event.node, event.at_s - job.since_s
    command.job = None
    if (trial := context.state.trials.get(job.kind)) and trial.new == job.program:
        del context.state.trials[job.kind]
        _prove(context.state, job.kind, job.program)
    try:
        stimulate(context, command, Stimulus.PRODUCT, event.product)
    except WireError as error:
        message = f"the {job.kind.value} delivered what is no product: {error}"
        stimulate(context, command, Stimulus.REFUSAL, Refusal(reason=RefusalReason.PROGRAM, message=message))


def on_job_declined(context: DecisionContext, event: JobDeclined) -> None:
    if untold.handle_answer(context, event) or (found := _pending(context, event.job, event.attempt)) is None:
        return
    command, job = found
    context.node, context.took_s = event.node, event.at_s - job.since_s
    if event.refusal.reason is RefusalReason.TIMEOUT:
        stimulate(context, command, Stimulus.UNAVAILABLE, event.refusal)
        return
    if event.refusal.reason is RefusalReason.PROGRAM and _with_another_program(
        context, command, job, event.refusal.message
    ):
        return
    command.job = None
    stimulate(context, command, Stimulus.REFUSAL, event.refusal)


def on_job_lost(context: DecisionContext, event: JobLost) -> None:
    if untold.handle_answer(context, event) or (found := _pending(context, event.job, event.attempt)) is None:
        return
    command, job = found
    context.node, context.took_s = event.node, event.at_s - job.since_s
    if event.blamed and _with_another_program(context, command, job, event.evidence):
        return
    stimulate(context, command, Stimulus.WORKER_LOST, event)


def _with_another_program(context: DecisionContext, command: Command, job: PendingJob, why: str) -> bool:
    """A job failed with a program. The first job of a new one: back to the old one. It is done again with the program
    that is the current one now; False when that is the one it failed with."""
    state = context.state
    trial = state.trials.get(job.kind)
    last_words = (why.strip().splitlines() or ["it ended without a word"])[-1]
    if trial is not None and trial.new == job.program:
        del state.trials[job.kind]
        state.programs[job.kind] = trial.old
        context.count("programs_rolled_back")
        told = f"the new {job.kind.value} program {trial.new} failed its first job ({last_words}); back to {trial.old}"
        state.rolled_back[job.kind] = f"{told}. The job was of {command.id}"
    else:
        told = f"the {job.kind.value} program {job.program}, which is used no more, failed ({last_words}); job again"
    current = state.programs.get(job.kind, job.program)
    if current == job.program:
        return False
    job.program = current
    job.attempt += 1
    context.note(command, told, warning=True)
    context.dispatch(job)
    return True


def _keep_file(state: State, event: ProgramInstalled) -> None:
    """For people, who know files and no digests; also after a roll-back, which goes back to an older digest."""
    state.program_files.pop(event.digest, None)
    state.program_files[event.digest] = (event.file, event.at_s)
    while len(state.program_files) > FILES_KEPT:
        del state.program_files[next(iter(state.program_files))]


def on_program(context: DecisionContext, event: ProgramInstalled) -> None:
    kind = event.kind or "cell"
    context.state.began_at_s = context.state.began_at_s or event.at_s  # it begins with its programs
    programs = context.state.programs
    if event.kind and kind in programs and programs[kind] != event.digest:
        untried = context.state.trials.pop(kind, None)  # it is no program to go back to
        old = untried.old if untried else programs[kind]
        _prove(context.state, kind, old)
        if event.digest not in context.state.proven[kind]:
            context.state.trials[kind] = Trial(new=event.digest, old=old)
    context.state.rolled_back.pop(kind, None)
    programs[kind] = event.digest
    if event.file:
        _keep_file(context.state, event)


def _prove(state: State, kind: str, digest: str) -> None:
    """This program works: loaded again after another one, it needs no trial, and is one to go back to."""
    proven = state.proven.setdefault(kind, [])
    if digest in proven:
        proven.remove(digest)
    proven.append(digest)
    del proven[:-PROVEN_KEPT]


# --- subsystems --------------------------------------------------------------------------------------


def on_started(context: DecisionContext, event: PrimitiveStarted) -> None:
    command = context.state.commands.get(command_of(event.primitive))
    awaited = command is not None and (command.primitive, command.subsystem) == (event.primitive, event.subsystem)
    if awaited and command is not None and command.phase is Phase.EXECUTING:
        context.node = event.subsystem
        context.note(command, "started")


def on_ended(context: DecisionContext, event: PrimitiveEnded) -> None:
    report = event.report
    command = context.state.commands.get(command_of(report.primitive))
    awaited = (
        command is not None
        and command.primitive == report.primitive
        and command.subsystem == event.subsystem
        and command.phase in (Phase.EXECUTING, Phase.HALTING)
    )
    if not awaited or command is None:
        # Late or double. It is acknowledged, or it would be repeated for ever; and it proves rest.
        context.count("stale")
        context.effects.append(AcknowledgeReport(subsystem=event.subsystem, primitive=report.primitive))
        if command is None or command.primitive == report.primitive:
            context.confirm_rest(event.subsystem, [], moved=report.primitive)
        return
    context.node, context.took_s = event.subsystem, event.at_s - command.sent_at_s
    stimulate(context, command, Stimulus.REPORT, report)


def on_halt_confirmed(context: DecisionContext, event: HaltConfirmed) -> None:
    name = event.halt.removeprefix(ending.STOP)  # a HALT sentence, or the command that was stopped
    if event.at_rest:
        context.confirm_rest(event.subsystem, event.performers, name if name != event.halt else "")
    command = context.state.commands.get(name)
    if command is not None and command.subsystem in ("", event.subsystem):  # "": of a HALT sentence
        context.node = event.subsystem
        stimulate(context, command, Stimulus.REST, event.at_rest)


def on_subsystem(context: DecisionContext, event: SubsystemConnected) -> None:
    """Come, or come back. What it does not know any more it never got, or it forgot by dying."""
    state = context.state
    before = state.subsystems.get(event.subsystem)
    if before is None and len(state.subsystems) >= MAX_SUBSYSTEMS and not _forget_a_subsystem(state):
        context.count("subsystems_declined")
        return
    reborn = before is not None and before.pid != event.pid
    if reborn:
        _lose_subsystem(context, event.subsystem, "it was restarted")
    state.subsystems[event.subsystem] = Subsystem(
        pid=event.pid, performers=event.performers, came_at_rest=event.at_rest
    )
    for primitive in event.outstanding:
        state.accepted = max(state.accepted, number_of(primitive))  # a journal that was lost may not know it
        command_id = command_of(primitive)
        command = state.commands.get(command_id)
        # Of a command that lives, only what was given up may still be executed; the rest are unacknowledged reports.
        if command is None or (command.phase is Phase.CLOSING and not command.at_rest):
            _order_halt(context, event.subsystem, f"orphan-{primitive}", command_id)
    if event.at_rest:
        context.confirm_rest(event.subsystem)
    elif not event.outstanding:
        _order_halt(context, event.subsystem, f"rejoin-{event.subsystem}-{context.now:.6f}", "ALL")
    if reborn:
        return
    for command in state.commands.values():
        if command.subsystem == event.subsystem and command.primitive_body != NIL:
            if command.phase is Phase.HALTING:
                ending.order_halt(context, command)
            elif command.phase is Phase.EXECUTING and command.primitive not in event.outstanding:
                journey.send(context, command)


def _forget_a_subsystem(state: State) -> bool:
    """One that is lost and that nothing waits for."""
    wanted = {c.subsystem for c in state.commands.values()} | {q.subsystem for q in state.resources.quarantine.values()}
    lost = (name for name, s in state.subsystems.items() if s.link is Link.LOST and name not in wanted)
    return state.subsystems.pop(next(lost, ""), None) is not None


def _order_halt(context: DecisionContext, subsystem: str, halt: str, scope: str) -> None:
    context.effects.append(SendHalt(subsystem=subsystem, halt=halt, scope=scope, called_at_s=context.now))


def on_subsystem_gone(context: DecisionContext, event: SubsystemGone) -> None:
    subsystem = context.state.subsystems.get(event.subsystem)
    if subsystem is not None and subsystem.link is not Link.LOST:
        subsystem.link = Link.LOST
        subsystem.came_at_rest = False
        context.count("subsystems_lost")
        _lose_subsystem(context, event.subsystem, event.why)


def _lose_subsystem(context: DecisionContext, name: str, why: str) -> None:
    """A global error (A30): every command that has worked through this subsystem ends."""
    message = f"{name} was lost: {why}"
    lost = PendingOutcome(
        kind=OutcomeKind.LOST_SUBSYSTEM,
        message=message,
        stop=StopReason.SUBSYSTEM_LOST,
        refusal=Refusal(reason=RefusalReason.STATE, message=message, clears=ending.RETRY_ADVICE),
    )
    for command in context.state.commands.values():
        if command.subsystem == name:
            moving = command.phase in (Phase.EXECUTING, Phase.HALTING)
            context.follow(command.id, Stimulus.SUBSYSTEM_LOST if moving else Stimulus.STOP, why if moving else lost)
        elif command.phase is Phase.HALTING and not command.primitive:
            context.follow(command.id, Stimulus.SUBSYSTEM_LOST, why)


def on_listeners(context: DecisionContext, event: ListenersChanged) -> None:
    if event.listening and not context.state.has_subscribers:
        lost.publish(context)
    context.state.has_subscribers = event.listening


# --- time and restart --------------------------------------------------------------------------------


def on_timer(context: DecisionContext, event: TimerFired) -> None:
    if untold.handle_timer(context, event.timer):
        return
    command = context.state.commands.get(event.timer)
    if command is None or not 0 < command.due_s <= event.at_s:
        context.count("stale")  # stopped or set anew in the turn in which it rang
        return
    command.due_s = 0.0
    stimulate(context, command, Stimulus.TIMEOUT)


def on_restart(context: DecisionContext, event: BrokerRestarted) -> None:
    """Everything that was given out is given out again; subsystems are waited for, they know what they do."""
    context.count("broker_restarts")
    context.state.has_subscribers = False  # who listens subscribes anew
    for subsystem in context.state.subsystems.values():
        if subsystem.link is Link.CONNECTED:
            subsystem.link = Link.AWAITED
    for name in context.state.deferred_analyses:
        untold.retry(context, name)
    for command in context.state.commands.values():
        if command.job is not None:
            command.job.attempt += 1
            context.dispatch(command.job)
        if command.phase is Phase.ANALYZING:
            command.due_s = 0.0  # it is being tried again
        if command.phase is Phase.EXECUTING:
            context.start_timer(command, ending.report_limit_s(context.state, command))
        elif command.phase is Phase.HALTING:
            context.start_timer(command, ending.rest_limit_s(context.state, reconnecting=True))
        elif command.phase is Phase.CLOSING:
            context.start_timer(command, ending.CLOSING_LIMIT_S)


HANDLERS: dict[type[Event], Callable[[DecisionContext, Any], None]] = {
    CommandReceived: on_command,
    HaltCalled: on_halt,
    JobFinished: on_job_finished,
    JobDeclined: on_job_declined,
    JobLost: on_job_lost,
    PrimitiveStarted: on_started,
    PrimitiveEnded: on_ended,
    HaltConfirmed: on_halt_confirmed,
    SubsystemConnected: on_subsystem,
    SubsystemGone: on_subsystem_gone,
    ClientGone: on_client_gone,
    TimerFired: on_timer,
    ProgramInstalled: on_program,
    ListenersChanged: on_listeners,
    BrokerRestarted: on_restart,
    JournalLost: lost.on_journal_lost,
}

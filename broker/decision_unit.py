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
    SubsystemConnected,
    SubsystemGone,
    TimerFired,
)
from broker.state import NIL, Command, Ending, Link, PendingJob, State, Subsystem, Trial, request_key
from broker.transitions import TABLE, Stimulus
from broker.turn import Turn
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

ACTIONS: dict[str, Callable[[Turn, Command, Any], None]] = {
    name: getattr(module, name)
    for name, module in (
        ("parsed", journey),
        ("take_up", journey),
        ("released", journey),
        ("granted", journey),
        ("elaborated", journey),
        ("bound", journey),
        ("reported", journey),
        ("assessed", journey),
        ("pause_later", journey),
        ("resume_now", journey),
        ("resume_paused", journey),
        ("refused", ending),
        ("undone", ending),
        ("analyze_later", ending),
        ("analyze_again", ending),
        ("again", ending),
        ("stop", ending),
        ("stop_subsystem", ending),
        ("stop_after_analysis", ending),
        ("overdue", ending),
        ("rested", ending),
        ("rest_confirmed", ending),
        ("unconfirmed", ending),
        ("lost_subsystem", ending),
        ("lost_while_halting", ending),
        ("closed", ending),
        ("closed_untold", ending),
    )
}
assert {action for action, _ in TABLE.values()} == set(ACTIONS), "every action of the table is here, and no other"


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
    turn = Turn(state, event.at_s)
    HEARD[type(event)](turn, event)
    for name, stimulus, payload in turn.followups:  # to which more are added meanwhile
        turn.node, turn.took_s = "", 0.0
        command = state.commands.get(name)
        if command is not None:
            stimulate(turn, command, stimulus, payload)
    return turn.effects


def stimulate(turn: Turn, command: Command, stimulus: Stimulus, payload: Any = None) -> None:
    before = command.phase
    cell = TABLE.get((before, stimulus))
    if cell is None:
        turn.count("stale")
        return
    action, following = cell
    ACTIONS[action](turn, command, payload)
    if command.phase not in following:
        raise InvalidTransition(command, before, stimulus)
    if before is Phase.PARSING and command.phase is not Phase.PARSING:
        turn.read(command)


# --- clients -----------------------------------------------------------------------------------------


def on_command(turn: Turn, event: CommandReceived) -> None:
    state = turn.state
    key = request_key(event.client, event.request)
    if known := state.requests.get(key):
        turn.effects.append(TellClient(client=event.client, message=Accepted(request=event.request, command=known)))
        if known in state.ended:
            turn.effects.append(TellClient(client=event.client, message=state.ended[known].told))
        return
    if lost.is_lost(state, event) and not halt_scope(event.text):
        lost.end_lost(turn, event)
        return
    live = state.live.get(event.client, 0)
    if live >= LIVE_PER_CLIENT or len(state.commands) >= MAX_COMMANDS:
        _decline(turn, event, live)
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
    turn.effects.append(TellClient(client=event.client, message=Accepted(request=event.request, command=command.id)))
    if scope := halt_scope(event.text):
        journey.halt_by_command(turn, command, scope)
    elif 0 < event.sent_at_s <= state.halted_at_s.get("ALL", 0.0):
        message = "sent before HALT ALL, so it does not start after it"
        ending.end(turn, command, OutcomeKind.HALTED, message=message, stop=StopReason.HALT)
    else:
        state.unread.setdefault(command.client, {})[command.id] = False
        turn.give_out(command, WorkerKind.PARSER, {"text": command.text})
        turn.enter(command, Phase.PARSING)


def _decline(turn: Turn, event: CommandReceived, live: int) -> None:
    """Too many are live. A halt is obeyed all the same."""
    turn.count("declined")
    message = f"{len(turn.state.commands)} commands are live, {live} of them yours; the limit is " + (
        f"{LIVE_PER_CLIENT} of one client" if live >= LIVE_PER_CLIENT else f"{MAX_COMMANDS} in all"
    )
    if scope := halt_scope(event.text):
        journey.halt(turn, f"declined-{turn.state.counts['declined']}", scope, turn.now)
        message = f"{scope} is halted, but nobody waits for rest: {message}"
    refusal = Refusal(reason=RefusalReason.OVERLOAD, message=message, clears="wait until some have ended")
    turn.effects.append(TellClient(client=event.client, message=Declined(request=event.request, refusal=refusal)))


def on_halt(turn: Turn, event: HaltCalled) -> None:
    """Stop what is in its scope now. Whether its name was used before does not matter: two callers may count from one,
    and a button may always say the same."""
    told_by_subsystem = event.client in turn.state.subsystems
    _count_halt(turn, event)
    known = journey.halt(turn, event.halt, event.scope, event.called_at_s, call=event.call)
    # Of a command that has ended nothing moves, as the subsystems confirm: that is no halt of nobody knows what.
    if not known and not told_by_subsystem and not journey.has_ended(turn, event.scope):
        message = journey.no_target(turn, event.scope).message
        turn.effects.append(DeclineHalt(client=event.client, halt=event.halt, message=message))
    if told_by_subsystem and not any(type(e) is SendHalt and e.subsystem == event.client for e in turn.effects):
        # It begins nothing until it hears that we know.
        turn.effects.append(
            SendHalt(
                subsystem=event.client,
                halt=event.halt,
                scope=event.scope,
                called_at_s=event.called_at_s,
                call=event.call,
            )
        )


def _count_halt(turn: Turn, event: HaltCalled) -> None:
    """A caller uses both doors, so most halts are received twice: from the caller, and from the subsystem."""
    halts, key = turn.state.halts, f"{event.halt} {event.scope} {event.called_at_s}"
    if key not in halts:
        turn.count("halts")
    halts[key] = event.at_s
    if len(halts) > HALTS_KEPT:
        del halts[next(iter(halts))]


def on_client_gone(turn: Turn, event: ClientGone) -> None:
    gone = Ending(kind=OutcomeKind.HALTED, message="its client went away", stop=StopReason.HALT)
    for command in turn.state.commands.values():
        if command.client == event.client and command.halt_if_lost:
            turn.follow(command.id, Stimulus.STOP, gone)


# --- workers -----------------------------------------------------------------------------------------


def _pending(turn: Turn, job: str, attempt: int) -> tuple[Command, PendingJob] | None:
    """The command that waits for just this answer; None (and counted) when the answer is stale."""
    command = turn.state.commands.get(job.partition("/")[0])
    if command is None or command.job is None or (command.job.id, command.job.attempt) != (job, attempt):
        turn.count("stale")
        return None
    return command, command.job


def on_job_finished(turn: Turn, event: JobFinished) -> None:
    if untold.heard(turn, event) or (found := _pending(turn, event.job, event.attempt)) is None:
        return
    command, job = found
    turn.node, turn.took_s = event.node, event.at_s - job.since_s
    command.job = None
    if (trial := turn.state.trials.get(job.kind)) and trial.new == job.program:
        del turn.state.trials[job.kind]
        _prove(turn.state, job.kind, job.program)
    try:
        stimulate(turn, command, Stimulus.PRODUCT, event.product)
    except WireError as error:
        message = f"the {job.kind.value} delivered what is no product: {error}"
        stimulate(turn, command, Stimulus.REFUSAL, Refusal(reason=RefusalReason.PROGRAM, message=message))


def on_job_declined(turn: Turn, event: JobDeclined) -> None:
    if untold.heard(turn, event) or (found := _pending(turn, event.job, event.attempt)) is None:
        return
    command, job = found
    turn.node, turn.took_s = event.node, event.at_s - job.since_s
    if event.refusal.reason is RefusalReason.TIMEOUT:
        stimulate(turn, command, Stimulus.AWAY, event.refusal)
        return
    if event.refusal.reason is RefusalReason.PROGRAM and _with_another_program(
        turn, command, job, event.refusal.message
    ):
        return
    command.job = None
    stimulate(turn, command, Stimulus.REFUSAL, event.refusal)


def on_job_lost(turn: Turn, event: JobLost) -> None:
    if untold.heard(turn, event) or (found := _pending(turn, event.job, event.attempt)) is None:
        return
    command, job = found
    turn.node, turn.took_s = event.node, event.at_s - job.since_s
    if event.blamed and _with_another_program(turn, command, job, event.evidence):
        return
    stimulate(turn, command, Stimulus.LOSS, event)


def _with_another_program(turn: Turn, command: Command, job: PendingJob, why: str) -> bool:
    """A job failed with a program. The first job of a new one: back to the old one. It is done again with the program
    that is the current one now; False when that is the one it failed with."""
    state = turn.state
    trial = state.trials.get(job.kind)
    last_words = (why.strip().splitlines() or ["it ended without a word"])[-1]
    if trial is not None and trial.new == job.program:
        del state.trials[job.kind]
        state.programs[job.kind] = trial.old
        turn.count("programs_rolled_back")
        told = f"the new {job.kind.value} program {trial.new} failed its first job ({last_words}); back to {trial.old}"
        state.rolled_back[job.kind] = f"{told}. The job was of {command.id}"
    else:
        told = f"the {job.kind.value} program {job.program}, which is used no more, failed ({last_words}); job again"
    current = state.programs.get(job.kind, job.program)
    if current == job.program:
        return False
    job.program = current
    job.attempt += 1
    turn.note(command, told, warning=True)
    turn.dispatch(job)
    return True


def _keep_file(state: State, event: ProgramInstalled) -> None:
    """For people, who know files and no digests; also after a roll-back, which goes back to an older digest."""
    state.program_files.pop(event.digest, None)
    state.program_files[event.digest] = (event.file, event.at_s)
    while len(state.program_files) > FILES_KEPT:
        del state.program_files[next(iter(state.program_files))]


def on_program(turn: Turn, event: ProgramInstalled) -> None:
    kind = event.kind or "cell"
    turn.state.began_at_s = turn.state.began_at_s or event.at_s  # it begins with its programs
    programs = turn.state.programs
    if event.kind and kind in programs and programs[kind] != event.digest:
        untried = turn.state.trials.pop(kind, None)  # it is no program to go back to
        old = untried.old if untried else programs[kind]
        _prove(turn.state, kind, old)
        if event.digest not in turn.state.proven[kind]:
            turn.state.trials[kind] = Trial(new=event.digest, old=old)
    turn.state.rolled_back.pop(kind, None)
    programs[kind] = event.digest
    if event.file:
        _keep_file(turn.state, event)


def _prove(state: State, kind: str, digest: str) -> None:
    """This program works: loaded again after another one, it needs no trial, and is one to go back to."""
    proven = state.proven.setdefault(kind, [])
    if digest in proven:
        proven.remove(digest)
    proven.append(digest)
    del proven[:-PROVEN_KEPT]


# --- subsystems --------------------------------------------------------------------------------------


def on_started(turn: Turn, event: PrimitiveStarted) -> None:
    command = turn.state.commands.get(command_of(event.primitive))
    awaited = command is not None and (command.primitive, command.subsystem) == (event.primitive, event.subsystem)
    if awaited and command is not None and command.phase is Phase.EXECUTING:
        turn.node = event.subsystem
        turn.note(command, "started")


def on_ended(turn: Turn, event: PrimitiveEnded) -> None:
    report = event.report
    command = turn.state.commands.get(command_of(report.primitive))
    awaited = (
        command is not None
        and command.primitive == report.primitive
        and command.subsystem == event.subsystem
        and command.phase in (Phase.EXECUTING, Phase.HALTING)
    )
    if not awaited or command is None:
        # Late or double. It is acknowledged, or it would be repeated for ever; and it proves rest.
        turn.count("stale")
        turn.effects.append(AcknowledgeReport(subsystem=event.subsystem, primitive=report.primitive))
        if command is None or command.primitive == report.primitive:
            turn.confirm_rest(event.subsystem, [], moved=report.primitive)
        return
    turn.node, turn.took_s = event.subsystem, event.at_s - command.sent_at_s
    stimulate(turn, command, Stimulus.REPORT, report)


def on_halt_confirmed(turn: Turn, event: HaltConfirmed) -> None:
    name = event.halt.removeprefix(ending.STOP)  # a HALT sentence, or the command that was stopped
    if event.at_rest:
        turn.confirm_rest(event.subsystem, event.performers, name if name != event.halt else "")
    command = turn.state.commands.get(name)
    if command is not None and command.subsystem in ("", event.subsystem):  # "": of a HALT sentence
        turn.node = event.subsystem
        stimulate(turn, command, Stimulus.REST, event.at_rest)


def on_subsystem(turn: Turn, event: SubsystemConnected) -> None:
    """Come, or come back. What it does not know any more it never got, or it forgot by dying."""
    state = turn.state
    before = state.subsystems.get(event.subsystem)
    if before is None and len(state.subsystems) >= MAX_SUBSYSTEMS and not _forget_a_subsystem(state):
        turn.count("subsystems_declined")
        return
    reborn = before is not None and before.pid != event.pid
    if reborn:
        _gone(turn, event.subsystem, "it was restarted")
    state.subsystems[event.subsystem] = Subsystem(
        pid=event.pid, performers=event.performers, came_at_rest=event.at_rest
    )
    for primitive in event.outstanding:
        state.accepted = max(state.accepted, number_of(primitive))  # a journal that was lost may not know it
        command_id = command_of(primitive)
        command = state.commands.get(command_id)
        # Of a command that lives, only what was given up may still be executed; the rest are unacknowledged reports.
        if command is None or (command.phase is Phase.CLOSING and not command.at_rest):
            _order_halt(turn, event.subsystem, f"orphan-{primitive}", command_id)
    if event.at_rest:
        turn.confirm_rest(event.subsystem)
    elif not event.outstanding:
        _order_halt(turn, event.subsystem, f"rejoin-{event.subsystem}-{turn.now:.6f}", "ALL")
    if reborn:
        return
    for command in state.commands.values():
        if command.subsystem == event.subsystem and command.primitive_body != NIL:
            if command.phase is Phase.HALTING:
                ending.order_halt(turn, command)
            elif command.phase is Phase.EXECUTING and command.primitive not in event.outstanding:
                journey.send(turn, command)


def _forget_a_subsystem(state: State) -> bool:
    """One that is lost and that nothing waits for."""
    wanted = {c.subsystem for c in state.commands.values()} | {q.subsystem for q in state.resources.quarantine.values()}
    lost = (name for name, s in state.subsystems.items() if s.link is Link.LOST and name not in wanted)
    return state.subsystems.pop(next(lost, ""), None) is not None


def _order_halt(turn: Turn, subsystem: str, halt: str, scope: str) -> None:
    turn.effects.append(SendHalt(subsystem=subsystem, halt=halt, scope=scope, called_at_s=turn.now))


def on_subsystem_gone(turn: Turn, event: SubsystemGone) -> None:
    subsystem = turn.state.subsystems.get(event.subsystem)
    if subsystem is not None and subsystem.link is not Link.LOST:
        subsystem.link = Link.LOST
        subsystem.came_at_rest = False
        turn.count("subsystems_lost")
        _gone(turn, event.subsystem, event.why)


def _gone(turn: Turn, name: str, why: str) -> None:
    """A global error (A30): every command that has worked through this subsystem ends."""
    message = f"{name} was lost: {why}"
    lost = Ending(
        kind=OutcomeKind.LOST_SUBSYSTEM,
        message=message,
        stop=StopReason.SUBSYSTEM_LOST,
        refusal=Refusal(reason=RefusalReason.STATE, message=message, clears=ending.LOOKED_AT_FIRST),
    )
    for command in turn.state.commands.values():
        if command.subsystem == name:
            moving = command.phase in (Phase.EXECUTING, Phase.HALTING)
            turn.follow(command.id, Stimulus.GONE if moving else Stimulus.STOP, why if moving else lost)
        elif command.phase is Phase.HALTING and not command.primitive:
            turn.follow(command.id, Stimulus.GONE, why)


def on_listeners(turn: Turn, event: ListenersChanged) -> None:
    if event.listening and not turn.state.listened:
        lost.publish(turn)
    turn.state.listened = event.listening


# --- time and restart --------------------------------------------------------------------------------


def on_timer(turn: Turn, event: TimerFired) -> None:
    if untold.rang(turn, event.timer):
        return
    command = turn.state.commands.get(event.timer)
    if command is None or not 0 < command.due_s <= event.at_s:
        turn.count("stale")  # stopped or set anew in the turn in which it rang
        return
    command.due_s = 0.0
    stimulate(turn, command, Stimulus.OVERDUE)


def on_restart(turn: Turn, event: BrokerRestarted) -> None:
    """Everything that was given out is given out again; subsystems are waited for, they know what they do."""
    turn.count("broker_restarts")
    turn.state.listened = False  # who listens subscribes anew
    for subsystem in turn.state.subsystems.values():
        if subsystem.link is Link.CONNECTED:
            subsystem.link = Link.AWAITED
    for name in turn.state.untold:
        untold.again(turn, name)
    for command in turn.state.commands.values():
        if command.job is not None:
            command.job.attempt += 1
            turn.dispatch(command.job)
        if command.phase is Phase.ANALYZING:
            command.due_s = 0.0  # it is being tried again
        if command.phase is Phase.EXECUTING:
            turn.start_timer(command, command.limit_s * turn.state.patience + journey.REPORT_MARGIN_S)
        elif command.phase in (Phase.HALTING, Phase.CLOSING):
            turn.start_timer(command, ending.HALT_LIMIT_S + journey.REPORT_MARGIN_S)


HEARD: dict[type[Event], Callable[[Turn, Any], None]] = {
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

"""How commands end: refused, stopped, lost, closed. Each function is one action of `broker.transitions`.

Rule 1: a command that was moving something is not over before its subsystem has come to rest (HALTING), or has
been given up. Rule 2: what it touched is put right in the world by one last analysis, whose advice is ignored
(CLOSING, R138, R151). Rule 3: `end` is the only way to ENDED, and nothing is done for a command after it.
"""

from __future__ import annotations

from itertools import islice
from typing import Any

from broker import reporting
from broker import untold as left
from broker.effects import AcknowledgeReport, CancelJob, ReportEnd, SendHalt
from broker.resources import Quarantine
from broker.state import NIL, Command, Ending, Result, request_key
from broker.transitions import Stimulus
from broker.turn import Turn
from rtc import wire
from rtc.messages import CommandEnded, CommandRecord, EndReport, Phase, WorkerKind
from rtc.outcomes import Outcome, OutcomeKind, Refusal, RefusalReason, StopReason

HALT_LIMIT_S = 2.0  # for a subsystem to confirm rest
CLOSING_LIMIT_S = 10.0  # for the last analysis; then the command ends without it
STOP = "stop-"  # with a command's number: the name of the halt that stops its primitive
ENDED_KEPT = 4096  # results kept, at least, for clients that ask again
FORGOTTEN_AT_ONCE = 512  # of them: finding the oldest key of a dict takes the longer the more were deleted before it

CLOSED = "what it touched stays closed until the world has been told"

LOOKED_AT_FIRST = "say the sentence again once the subsystem is back: where the arm stands is looked at first"

UNCONFIRMED = (OutcomeKind.HALT_NOT_CONFIRMED, OutcomeKind.LOST_SUBSYSTEM)


def end(
    turn: Turn,
    command: Command,
    kind: OutcomeKind,
    *,
    message: str = "",
    stop: StopReason | None = None,
    refusal: Refusal | None = None,
    untold: bool = False,
) -> None:
    """The only way to ENDED: free everything, tell everybody. `untold`: but for what its last analysis is to write,
    which goes on without it."""
    state = turn.state
    outcome = Outcome(
        kind=kind,
        message=message,
        stop=stop,
        refusal=refusal,
        step=command.step_words if kind is not OutcomeKind.SUCCEEDED else "",
        trims=command.trims_told,
        steps_done=command.steps_done,
        measured=command.measured,
    )
    if untold:
        left.keep(turn, command)
    command.job = None
    turn.enter(command, Phase.ENDED, f"{kind.value}{': ' + message if message else ''}")
    in_doubt = Quarantine(command.subsystem, command.primitive) if _in_doubt(command, kind) else None
    granted = state.resources.release(command.id, in_doubt, frozenset(command.performers))
    for waiting in state.awaiting.pop(command.id, ()):
        turn.follow(waiting, Stimulus.RELEASE, kind is OutcomeKind.SUCCEEDED)
    for waiting in state.joining.pop(command.id, ()):
        turn.follow(waiting, Stimulus.RELEASE, False)
    turn.grant(granted)  # last: what came AFTER it stands before those given later
    turn.count(kind.value)
    state.seq += 1
    ended = CommandEnded(
        seq=state.seq,
        at_s=turn.now,
        command=command.id,
        request=command.request,
        text=command.text,
        outcome=outcome,
        took_s=turn.now - command.accepted_at_s,
    )
    record = CommandRecord(
        command=command.id,
        text=command.text,
        source=command.source,
        request=command.request,
        accepted_at_s=command.accepted_at_s,
        phase=Phase.ENDED,
        notes=command.notes,
        outcome=outcome,
        ended_at_s=turn.now,
    )
    turn.effects.append(ReportEnd(client=command.client, ended=ended, record=record))
    del state.commands[command.id]
    state.live[command.client] -= 1
    if not state.live[command.client]:
        del state.live[command.client]
    _remember(turn, command, ended)


def _in_doubt(command: Command, kind: OutcomeKind) -> bool:
    return kind in UNCONFIRMED and not command.at_rest


def _remember(turn: Turn, command: Command, ended: CommandEnded) -> None:
    """Keep the result for a client that comes back for it; forget the oldest."""
    state = turn.state
    succeeded = ended.outcome.kind is OutcomeKind.SUCCEEDED
    state.ended[command.id] = Result(wire.raw(ended), succeeded, request_key(command.client, command.request))
    if len(state.ended) < ENDED_KEPT + FORGOTTEN_AT_ONCE:
        return
    for oldest in list(islice(state.ended, FORGOTTEN_AT_ONCE)):
        del state.requests[state.ended.pop(oldest).request]


# --- refused -----------------------------------------------------------------------------------------


def refuse(turn: Turn, command: Command, refusal: Refusal) -> None:
    if command.given_up is not None:
        end_given_up(turn, command, refusal.message)
        return
    end(turn, command, OutcomeKind.REFUSED, message=refusal.message, refusal=refusal)


def end_given_up(turn: Turn, command: Command, after: str = "") -> None:
    """It fails of what made it give up, whatever came `after` that."""
    cause = command.given_up
    assert cause is not None
    message = f"{cause.message}; after that: {after}" if after else cause.message
    end(turn, command, cause.kind, message=message, stop=cause.stop, refusal=cause.refusal)


def refused(turn: Turn, command: Command, refusal: Refusal) -> None:
    refuse(turn, command, refusal)


# --- the world away ----------------------------------------------------------------------------------


def undone(turn: Turn, command: Command, refusal: Refusal) -> None:
    """What is asked for before a motion: nothing is tried then, or nothing more."""
    if command.primitives:
        end(turn, command, OutcomeKind.FAILED, message=refusal.message, refusal=refusal)
    else:
        refuse(turn, command, refusal)


def analyze_later(turn: Turn, command: Command, refusal: Refusal) -> None:
    """What has happened must be judged and told to the world; that it is away is no fault of the job."""
    job = command.job
    assert job is not None
    job.attempt += 1  # what the one before may still say is stale
    if turn.now - job.since_s <= left.LIMIT_S:
        turn.count("analyses_again")
        turn.start_timer(command, left.AGAIN_S)
        turn.note(command, f"{refusal.message}; it is asked again")
        return
    message = f"what was done could not be judged within {left.LIMIT_S:.0f} s: {refusal.message}; {CLOSED}"
    refusal = Refusal(reason=refusal.reason, message=message, clears="wait until the world database is back")
    end(turn, command, OutcomeKind.FAILED, message=message, refusal=refusal, untold=True)
    left.later(turn, command.id)


def analyze_again(turn: Turn, command: Command, _: Any) -> None:
    assert command.job is not None
    turn.dispatch(command.job)


# --- a worker lost -----------------------------------------------------------------------------------


def again(turn: Turn, command: Command, loss: Any) -> None:
    """Give the job out anew: it is stateless. A job that was in hand at three deaths is poison."""
    job = command.job
    assert job is not None
    if loss.blamed:
        job.deaths.append(f"{loss.node}: {loss.evidence}")
    if len(job.deaths) < left.MAX_DEATHS:
        job.attempt += 1
        turn.count("jobs_again")
        turn.note(
            command, f"{loss.node} lost ({loss.evidence.splitlines()[-1] if loss.evidence else 'gone'}); job again"
        )
        turn.dispatch(job)
        return
    message = f"the {job.kind.value}'s job {job.id} killed its worker {len(job.deaths)} times"
    refusal = Refusal(
        reason=RefusalReason.POISON,
        message=message,
        where=command.step_words,
        clears="the evidence is in the trace; change the sentence or the program",
        detail={f"death {n}": evidence[-800:] for n, evidence in enumerate(job.deaths, 1)},
    )
    if command.phase is Phase.CLOSING:
        closed(turn, command, None)
    elif command.phase is Phase.ANALYZING:
        end(turn, command, OutcomeKind.FAILED, message=message, refusal=refusal)
    else:
        refuse(turn, command, refusal)


# --- stopped -----------------------------------------------------------------------------------------


def stop(turn: Turn, command: Command, ending: Ending) -> None:
    """Nothing moves for it: it ends at once, and an answer still under way will be stale."""
    cancel(turn, command)
    end(turn, command, ending.kind, message=ending.message, stop=ending.stop)


def cancel(turn: Turn, command: Command) -> None:
    if command.job is not None:
        turn.effects.append(CancelJob(job=command.job.id))
        command.job = None


def stop_subsystem(turn: Turn, command: Command, ending: Ending) -> None:
    """Its primitive is being executed: stop that, and wait for rest."""
    command.ending = ending
    order_halt(turn, command)
    turn.enter(command, Phase.HALTING, ending.message)


def order_halt(turn: Turn, command: Command) -> None:
    turn.effects.append(
        SendHalt(subsystem=command.subsystem, halt=f"{STOP}{command.id}", scope=command.id, called_at_s=turn.now)
    )
    turn.start_timer(command, HALT_LIMIT_S * max(1.0, turn.state.patience))


def overdue(turn: Turn, command: Command, _: Any) -> None:
    """The subsystem has not reported within the primitive's own limit. F is complete, so this is its fault."""
    message = f"{command.subsystem} gave no end report within {command.limit_s:.1f} s"
    stop_subsystem(turn, command, Ending(kind=OutcomeKind.FAILED, message=message, stop=StopReason.TIMEOUT))


def rested(turn: Turn, command: Command, report: EndReport) -> None:
    """An end report comes after rest, whatever its reason: the motion may have ended by itself meanwhile."""
    turn.stop_timer(command)
    command.measured = reporting.at_end(command, report)
    turn.effects.append(AcknowledgeReport(subsystem=command.subsystem, primitive=command.primitive))
    command.primitive_body = NIL
    command.at_rest = True
    close(turn, command, report, f"at rest: {report.reason.value}")


def rest_confirmed(turn: Turn, command: Command, at_rest: bool) -> None:
    """Of a HALT sentence, which ends when all that were told have confirmed; or of the halt that stops this command's
    primitive. An end report comes before rest is confirmed: if there was none, the subsystem never had the primitive.
    """
    assert command.ending is not None
    if command.primitive:
        if at_rest:
            command.at_rest = True
            close(turn, command, nobody_reports(turn, command, StopReason.HALT), "at rest: it had not begun")
        return
    if turn.node not in command.unconfirmed:
        return  # told twice, or it was not asked
    command.unconfirmed.remove(turn.node)
    if not at_rest:
        turn.stop_timer(command)
        end(turn, command, OutcomeKind.HALT_NOT_CONFIRMED, message=f"{turn.node} is not at rest")
    elif not command.unconfirmed:
        turn.stop_timer(command)
        end(turn, command, command.ending.kind, message=command.ending.message)


def unconfirmed(turn: Turn, command: Command, _: Any) -> None:
    who = command.subsystem or ", ".join(command.unconfirmed) or "any subsystem"
    message = f"halted, but rest was not confirmed by {who} within {HALT_LIMIT_S:.0f} s"
    command.ending = Ending(kind=OutcomeKind.HALT_NOT_CONFIRMED, message=message, stop=StopReason.HALT)
    if command.primitive:
        close(turn, command, nobody_reports(turn, command), message)
    else:  # a HALT that came as a sentence: it touched nothing
        end(turn, command, OutcomeKind.HALT_NOT_CONFIRMED, message=message, stop=StopReason.HALT)


# --- a subsystem lost --------------------------------------------------------------------------------


def lost_subsystem(turn: Turn, command: Command, why: str) -> None:
    message = f"{command.subsystem} was lost while executing: {why}"
    command.ending = Ending(
        kind=OutcomeKind.LOST_SUBSYSTEM,
        message=message,
        stop=StopReason.SUBSYSTEM_LOST,
        refusal=Refusal(reason=RefusalReason.STATE, message=message, clears=LOOKED_AT_FIRST),
    )
    command.at_rest = turn.state.subsystems[command.subsystem].came_at_rest
    close(turn, command, nobody_reports(turn, command), message)


def lost_while_halting(turn: Turn, command: Command, why: str) -> None:
    who = command.subsystem or "a subsystem"
    message = f"{who} was lost before it confirmed rest: {why}"
    command.ending = Ending(kind=OutcomeKind.HALT_NOT_CONFIRMED, message=message, stop=StopReason.SUBSYSTEM_LOST)
    if command.primitive:
        command.at_rest = turn.state.subsystems[command.subsystem].came_at_rest
        close(turn, command, nobody_reports(turn, command), message)
    else:  # a HALT that came as a sentence: it touched nothing
        turn.stop_timer(command)
        end(turn, command, OutcomeKind.HALT_NOT_CONFIRMED, message=message, stop=StopReason.SUBSYSTEM_LOST)


def nobody_reports(turn: Turn, command: Command, reason: StopReason = StopReason.SUBSYSTEM_LOST) -> EndReport:
    """What stands in for the report of a subsystem that is gone: no figures, only the reason."""
    return EndReport(
        primitive=command.primitive,
        performer=command.performers[0],
        reason=reason,
        at_s=turn.now,
        duration_s=0.0,
        joints=[],
        tcp_pose=[],
        wrench=[],
        hand_width_m=0.0,
        hand_force_n=0.0,
    )


# --- closing -----------------------------------------------------------------------------------------


def close(turn: Turn, command: Command, report: EndReport, note: str) -> None:
    """One last analysis, for the world's sake alone."""
    assert command.script is not None
    turn.stop_timer(command)
    command.primitive_body = NIL
    data = {"evaluation": command.evaluation, "report": report, "closing": True}
    turn.give_out(command, WorkerKind.ANALYZER, data, locations=command.script.writes)
    turn.start_timer(command, CLOSING_LIMIT_S)
    turn.enter(command, Phase.CLOSING, note)


def stop_after_analysis(turn: Turn, command: Command, ending: Ending) -> None:
    """The report is in the analyzer's hands: let the world have it, ignore the advice (R138)."""
    command.ending = ending
    if command.due_s:  # the world was away, and it was to be tried again
        analyze_again(turn, command, None)
    turn.start_timer(command, CLOSING_LIMIT_S)
    turn.enter(command, Phase.CLOSING, f"{ending.message}; the analysis is let finish, its advice ignored")


def closed(turn: Turn, command: Command, product: Any) -> None:
    """`product` is the ignored advice; None or a refusal when the world could not be put right."""
    assert command.ending is not None
    turn.stop_timer(command)
    cancel(turn, command)
    ending = command.ending
    end(turn, command, ending.kind, message=ending.message, stop=ending.stop, refusal=ending.refusal)


def closed_untold(turn: Turn, command: Command, refusal: Refusal | None) -> None:
    """The world is away (a refusal), or the answer takes too long (None): nobody has to wait for that, but what was
    done is not forgotten."""
    assert command.ending is not None
    job = command.job
    assert job is not None
    turn.stop_timer(command)
    ending = command.ending
    message = f"{ending.message}; {CLOSED}"
    end(turn, command, ending.kind, message=message, stop=ending.stop, refusal=ending.refusal, untold=True)
    if refusal is not None:
        job.attempt += 1
        left.later(turn, command.id)

"""Invariants of the Decision Unit that hold in every reachable state. Pure.

The property tests, the model check and the cluster simulation use them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from broker.decisions.effects import CancelJob, DispatchJob, Effect, PublishNote, ReportEnd, SendPrimitive, StartTimer
from broker.decisions.resources import WORLD, number
from broker.decisions.state import NIL, State, queues_of
from rtc.protocol.messages import Phase, WorkerKind
from rtc.protocol.primitive import apart
from rtc.protocol.primitive_id import command_of

MOVING = (Phase.EXECUTING, Phase.HALTING)
BY_JOB = (
    Phase.PARSING,
    Phase.REHEARSING,
    Phase.ELABORATING,
    Phase.BINDING,
    Phase.ANALYZING,
    Phase.CLOSING,
)  # a worker has its job


def violations(state: State) -> list[str]:
    """The violated invariants in words; an empty list means a valid state."""
    return [*_resources(state), *_motions(state), *_space(state), *_commands(state)]


def _resources(state: State) -> Iterable[str]:
    r = state.resources
    for name, holders in r.holders.items():
        if len(holders) > 1 and any(holders.values()):
            yield f"{name} is held by {', '.join(holders)}, and one of them alone"
    for claims, index in ((r.held, r.holders), (r.waiting, r.lines)):
        listed = {(command, name) for name, commands in index.items() for command in commands}
        if listed != {(command, name) for command, claim in claims.items() for name in claim}:
            yield "the two views of the claims differ"
    for command in [*r.held, *r.waiting]:
        if command not in state.commands:
            yield f"{command} has ended and still claims"
    for name, by in r.quarantine.items():
        if by.subsystem == WORLD and by.primitive not in state.deferred_analyses:
            yield f"{name} is quarantined for {by.primitive}, which has no deferred analysis"
    for command, left in state.deferred_analyses.items():
        if command in state.commands or any(name not in r.quarantine or name in r.holders for name in left.names):
            yield f"the analysis of {command} is deferred, and {left.names} are not quarantined"
    for name, line in r.lines.items():
        if line != sorted(line, key=number):
            yield f"{line} wait for {name}, not in order"
        if [command for command in line if r.waiting[command][name]] != r.alone.get(name, []):
            yield f"{r.alone.get(name)} are not the exclusive waiters of {name}"
    if not r.alone.keys() <= r.lines.keys():
        yield f"{[*r.alone]} have exclusive waiters that are not in their lines"
    for command in r.waiting:
        if command in r.held:
            yield f"{command} waits while holding"


def _motions(state: State) -> Iterable[str]:
    moving: dict[str, str] = {}
    queues = queues_of(state)
    for command in state.commands.values():
        if command.phase in MOVING and command.id not in state.halt_sentences:
            for performer in command.performers:
                held = state.resources.held.get(command.id, {})
                if performer in queues:
                    if performer not in held:
                        yield f"{command.id} uses {performer} without a claim"
                    continue
                if performer in moving:
                    yield f"{performer} executes for {moving[performer]} and {command.id}"
                moving[performer] = command.id
                if not held.get(performer):
                    yield f"{command.id} moves {performer} without holding it"


def _space(state: State) -> Iterable[str]:
    """Of two motions that may meet, the later one was planned beside the earlier one; and no wait is for ever."""
    motions = list(state.motions.items())
    for n, (arm, motion) in enumerate(motions):
        if motion.command not in state.commands and arm not in state.resources.quarantine:
            yield f"the motion {motion.primitive} of {arm} is of a command that has ended"
        for _, other in motions[n + 1 :]:
            if motion.command == other.command or apart(motion.space, other.space):
                continue
            if other.primitive not in motion.beside and motion.primitive not in other.beside:
                yield f"{motion.primitive} and {other.primitive} were planned without each other"
    lines = {(command, arm) for arm, waiting in state.space_lines.items() for command in waiting}
    if lines != {(c.id, c.waits_for) for c in state.commands.values() if c.phase is Phase.WAITING}:
        yield f"{lines} are not the commands that wait for space"
    for first in state.commands.values():
        seen, command = set(), first
        while command.phase is Phase.WAITING:
            owners = [name for name, alone in state.resources.holders.get(command.waits_for, {}).items() if alone]
            if not owners or command.id in seen:
                yield f"{first.id} waits for space of an arm that cannot leave"
                break
            seen.add(command.id)
            command = state.commands[owners[0]]


def _commands(state: State) -> Iterable[str]:
    """A command that waits for nothing would never end."""
    if state.live != Counter(command.client for command in state.commands.values()):
        yield f"{state.live} is not how many commands each client has live"
    unread = {command for line in state.intake_order.values() for command in line}
    if unread != {command.id for command in state.commands.values() if command.phase is Phase.PARSING}:
        yield f"{unread} are not those being parsed"
    for client, line in state.intake_order.items():
        if list(line) != sorted(line, key=number) or not line or next(iter(line.values())):
            yield f"{line} of {client} is empty, not in order, or its first is not taken up"
    for name, request in state.halt_sentences.items():
        if request.settled or name not in state.commands or state.commands[name].phase is not Phase.HALTING:
            yield f"{name} is not a HALT sentence that waits for rest"
    joined = {c for waiting in [*state.awaiting.values(), *state.joining.values()] for c in waiting}
    joined |= state.answers.keys()
    joined |= {c for one in state.surrenders.values() for c in one.waiting}
    for answer, message in state.answers.items():
        asked = state.commands.get(command_of(message.primitive))
        if answer in state.commands and (asked is None or asked.primitive != message.primitive):
            yield f"{answer} answers what has ended"
    for command in state.commands.values():
        waits_its_turn = state.intake_order.get(command.client, {}).get(command.id, False)
        by_job = command.phase in BY_JOB and not waits_its_turn
        if by_job != (command.job is not None):
            yield f"{command.id} is {command.phase.value} and {'has no' if by_job else 'has a'} job"
        if command.phase is Phase.HELD and command.id not in state.resources.waiting and command.id not in joined:
            yield f"{command.id} is held and in no line"
        if command.phase is Phase.EXECUTING and (not command.primitive or command.primitive_body == NIL):
            yield f"{command.id} is executing nothing"
        waits_for_rest = command.phase is Phase.HALTING and command.id in state.halt_sentences
        if command.phase in (Phase.HALTING, Phase.CLOSING) and not waits_for_rest and command.pending_outcome is None:
            yield f"{command.id} is {command.phase.value} and has no pending outcome"
        if command.phase is Phase.ENDED:
            yield f"{command.id} has ended and is still here"


def forbidden(before: State, live_before: set[str], effects: list[Effect], *, halt_all: bool) -> list[str]:
    """The forbidden effects of one event: work for a command that has ended, and a second end. After HALT ALL, also
    anything new for a command that was there."""
    wrong, ended = [], set()
    for effect in effects:
        match effect:
            case ReportEnd():
                if effect.ended.command in ended:
                    wrong.append(f"{effect.ended.command} ended twice")
                ended.add(effect.ended.command)
            case DispatchJob():
                command = effect.job.partition("/")[0]
                if command in ended:
                    wrong.append(f"a job for {command}, which has ended")
                if halt_all and command in live_before and effect.kind is not WorkerKind.ANALYZER:
                    wrong.append(f"a job for {command} after HALT ALL")
            case SendPrimitive():
                command = command_of(effect.id)
                if command in ended or (halt_all and command in live_before):
                    wrong.append(f"a primitive for {command}, which was stopped")
            case StartTimer():
                if effect.timer in ended:
                    wrong.append(f"a timer for {effect.timer}, which has ended")
            case PublishNote():
                if effect.note.command in ended:
                    wrong.append(f"a note on {effect.note.command} after its end")
            case CancelJob():
                pass
    return wrong

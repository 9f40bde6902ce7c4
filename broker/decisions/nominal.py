"""The nominal path of a command: actions of `broker.decisions.transitions` in the order of docs/journey.md.

It also contains PAUSE, RESUME, ABORT and HALT. The actions know phases, resources, outcomes and steps as opaque bytes.
They do not know skills, geometry or sockets.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import msgspec

from broker.decisions import action_stack, reporting
from broker.decisions.context import DecisionContext, read_step, step_in_words
from broker.decisions.effects import AcknowledgeReport, SendHalt, SendPrimitive
from broker.decisions.events import Stimulus
from broker.decisions.resources import Claim, number
from broker.decisions.state import (
    NIL,
    AssessmentHead,
    BoundHead,
    Command,
    Link,
    ParsedHead,
    PendingOutcome,
    ScriptHead,
)
from broker.decisions.termination import close, end, end_given_up, refuse, report_limit_s, rest_limit_s
from rtc.protocol import wire
from rtc.protocol.messages import EndReport, Phase, WorkerKind
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason, StopReason
from rtc.protocol.primitive import Primitive
from rtc.protocol.primitive_id import belongs_to, primitive_id

LAST = "LAST"  # stands for the number of the client's previous command
MAX_ELABORATIONS = 20  # maximum per command, if its claim changes with each elaboration

CONTROLS = {"PAUSE": Stimulus.PAUSE, "RESUME": Stimulus.RESUME, "ABORT": Stimulus.STOP}  # all control verbs except HALT

read_parsed = wire.decoder(ParsedHead)
read_script = wire.decoder(ScriptHead)
read_bound = wire.decoder(BoundHead)
read_primitive = wire.decoder(Primitive)  # read completely, so that a subsystem never receives an invalid primitive
read_assessment = wire.decoder(AssessmentHead)


# --- parsed ------------------------------------------------------------------------------------------


def on_parsed(context: DecisionContext, command: Command, product: msgspec.Raw) -> None:
    command.parsed = product
    command.head = head = _with_last(read_parsed(product), command.previous)
    if head.test:  # checked first: TEST HALT must not halt
        message = "hypothesis tests (TEST ...) are not in this release"
        clears = "`rtc parse` shows how the sentence is read; without TEST it moves"
        refuse(context, command, Refusal(reason=RefusalReason.NO_SCRIPT, message=message, clears=clears))
    elif refusal := _broker_refusal(command, head):
        refuse(context, command, refusal)
    elif context.is_next(command) or (head.kind == "control" and not _concerns_earlier(head)):
        take_up(context, command)
    else:
        context.state.intake_order[command.client][command.id] = True


def _with_last(head: ParsedHead, previous: str) -> ParsedHead:
    """Replace LAST by the number of the client's previous command."""
    if previous and head.after == LAST:
        return msgspec.structs.replace(head, after=previous)
    if previous and head.together_with == LAST:
        return msgspec.structs.replace(head, together_with=previous)
    return head


def _broker_refusal(command: Command, head: ParsedHead) -> Refusal | None:
    """Refuse what only the broker can check: LAST without a previous command, REPORT EVERY without a reader."""
    if LAST in (head.after, head.together_with):
        word = "AFTER" if head.after else "TOGETHER-WITH"
        message = f"{word} {LAST}: this client has given no command before this one"
        clears = f"give the number: {word} C-n (`rtc log` lists the commands), or leave it out"
        return Refusal(reason=RefusalReason.NAME, message=message, where=LAST, clears=clears)
    if head.report is not None and head.report.every_s is not None and not command.progress:
        message = "REPORT EVERY: this client does not take progress notes, so the reports would not be delivered"
        clears = "wait for the command (rtc do without --no-wait; on_progress in Python), or leave out EVERY"
        return Refusal(reason=RefusalReason.STATE, message=message, where="EVERY", clears=clears)
    return None


def take_up(context: DecisionContext, command: Command, _: Any = None) -> None:
    """Start the command after parsing. The commands of one client are taken up in the order given, however long each
    takes to parse: the first of two commands for one arm is first in line."""
    assert command.head is not None
    if command.head.kind == "control":
        control(context, command, command.head)
    elif not _wait_for_another(context, command, command.head):
        claim_and_elaborate(context, command)


def _scope(head: ParsedHead) -> str:
    scope = head.object or head.hand or "ALL"
    return "ALL" if scope == "BOTH-ARMS" else scope


def _concerns_earlier(head: ParsedHead) -> bool:
    """True for PAUSE, RESUME and ABORT of an arm: the client's earlier commands must be parsed to know which use it.
    HALT does not wait; ALL and a number need no parsed commands."""
    scope = _scope(head)
    return head.verb != "HALT" and scope != "ALL" and not scope.startswith("C-")


def control(context: DecisionContext, command: Command, head: ParsedHead) -> None:
    """Apply PAUSE, RESUME, ABORT or HALT to one command, to the users of a resource, or to all."""
    scope = _scope(head)
    if head.verb == "HALT":
        halt_by_command(context, command, scope)
        return
    if head.verb not in CONTROLS:
        message = f"the grammar lists {head.verb!r:.80} as a control verb, which it is not"
        refuse(context, command, Refusal(reason=RefusalReason.PROGRAM, message=message))
        return
    targets = [c.id for c in in_scope(context, scope) if c.id == scope or not _given_after(c, command)]
    if not targets and scope != "ALL":
        refuse(context, command, no_target(context, scope, command.id))
        return
    stimulus = CONTROLS[head.verb]
    words = f"{head.verb} of {', '.join(targets)}" if targets else f"{head.verb} had nothing to act on"
    if answer := PAUSE_ANSWERS.get(stimulus):
        answers = {name: answer(context.state.commands[name]) for name in targets}
        targets = [name for name, (will, _) in answers.items() if will]
        words = "; ".join(f"{name} {what}" for name, (_, what) in answers.items()) or words
        if answers and not targets:
            clears = f"HALT {scope} stops now, and ends it" if stimulus is Stimulus.PAUSE else ""
            refuse(context, command, Refusal(reason=RefusalReason.STATE, message=words, clears=clears))
            return
    ending = PendingOutcome(kind=OutcomeKind.ABORTED, message=f"aborted by {command.id}")
    for target in targets:
        context.follow(target, stimulus, ending if stimulus is Stimulus.STOP else None)
    end(context, command, OutcomeKind.SUCCEEDED, message=words)


def _given_after(other: Command, command: Command) -> bool:
    """True if the same client gave `other` at or after `command`. A PAUSE does not concern it, even if it is parsed."""
    return other.client == command.client and number(other.id) >= number(command.id)


Answer = tuple[bool, str]  # (is the request accepted?, what the command does, in words)


def _will_pause(command: Command) -> Answer:
    """Whether a command can pause. It pauses between two steps only (R101), so not in its last step."""
    if command.phase is Phase.PAUSED:
        return False, "is paused already"
    if command.phase in (Phase.HALTING, Phase.CLOSING):
        return False, "is ending"
    if command.actions is None or command.actions.step is None:
        return True, "pauses before its first step"
    if command.actions.refs:
        return True, f"pauses after step {command.step_words}"
    return False, f"is in its last step ({command.step_words}) and ends with it"


def _will_resume(command: Command) -> Answer:
    going = command.phase is not Phase.PAUSED and not command.pause_wanted
    return (False, "was not paused") if going else (True, "goes on")


PAUSE_ANSWERS = {Stimulus.PAUSE: _will_pause, Stimulus.RESUME: _will_resume}


def halt_by_command(context: DecisionContext, command: Command, scope: str) -> None:
    """Start a HALT sentence. It ends when rest is confirmed; its own halt does not stop it."""
    if scope != "ALL" and not _subsystem_of(context, scope) and not in_scope(context, scope):
        if has_ended(context, scope):
            end(context, command, OutcomeKind.SUCCEEDED, message=f"{scope} has already ended: it moves nothing")
        else:
            refuse(context, command, no_target(context, scope, command.id))
        return
    target = context.state.commands.get(scope)
    if target is not None and not target.subsystem:
        context.follow(scope, Stimulus.STOP, _halted(scope))
        end(context, command, OutcomeKind.SUCCEEDED, message=f"{scope} had moved nothing yet")
        return
    command.pending_outcome = PendingOutcome(kind=OutcomeKind.SUCCEEDED, message=f"{scope} at rest")
    context.enter(command, Phase.HALTING, f"halt {scope}")
    context.start_timer(command, rest_limit_s(context.state))
    halt(context, command.id, scope, context.now, spare=command.id)
    command.unconfirmed = [e.subsystem for e in context.effects if type(e) is SendHalt and e.halt == command.id]


def halt(
    context: DecisionContext,
    halt_id: str,
    scope: str,
    called_at_s: float,
    spare: str = "",
    call: str = "",
    received_at_s: float = 0.0,
) -> bool:
    """Halt the subsystems in scope, then stop the commands. False: the scope is unknown.

    A subsystem may forward a halt late, after an absence of the broker. Its time of receipt, if known, then parts the
    commands: those sent later go on. They have not begun to move there, because the subsystem fenced the scope."""
    state = context.state
    targets = in_scope(context, scope)
    performer = _subsystem_of(context, scope)
    if scope != "ALL" and not targets and not performer:
        return False
    if scope not in state.commands:
        at_s = min(called_at_s or context.now, context.now)
        state.halted_at_s[scope] = max(at_s, state.halted_at_s.get(scope, 0.0))  # an earlier halt may arrive later
    for name, subsystem in state.subsystems.items():
        concerned = scope == "ALL" or name == performer or any(c.subsystem == name for c in targets)
        if concerned and subsystem.link is not Link.LOST:
            context.effects.append(
                SendHalt(subsystem=name, halt=halt_id, scope=scope, called_at_s=called_at_s, call=call)
            )
    for command in targets:
        if command.id != spare and not _was_sent_after(command, received_at_s):
            context.follow(command.id, Stimulus.STOP, _halted(scope))
    return True


def _was_sent_after(command: Command, received_at_s: float) -> bool:
    """Whether a command was sent after a subsystem received a halt. A sender that gives no time, or a time in the
    future, has `given_at_s` equal to `accepted_at_s`: it may have been sent earlier."""
    return 0.0 < received_at_s < command.given_at_s < command.accepted_at_s


def _halted(scope: str) -> PendingOutcome:
    return PendingOutcome(kind=OutcomeKind.HALTED, message=f"halted ({scope})", stop=StopReason.HALT)


def in_scope(context: DecisionContext, scope: str) -> list[Command]:
    """The live commands in a scope: all, one by its number, or those that hold, want or name a resource."""
    state = context.state
    if scope == "ALL":
        return list(state.commands.values())
    if scope in state.commands:
        return [state.commands[scope]]
    claim = {*state.resources.holders.get(scope, ()), *state.resources.lines.get(scope, ())}
    hands = {scope, "BOTH-ARMS"} if _subsystem_of(context, scope) else {scope} - {"BOTH-ARMS"}
    return [c for c in state.commands.values() if c.id in claim or (c.head and _names(c.head, scope, hands))]


def _names(head: ParsedHead, scope: str, hands: set[str]) -> bool:
    return head.kind == "task" and (head.object == scope or head.hand in hands or head.to_hand in hands)


def _subsystem_of(context: DecisionContext, performer: str) -> str:
    return next((n for n, s in context.state.subsystems.items() if performer in s.performers), "")


def has_ended(context: DecisionContext, scope: str) -> bool:
    """True if the scope is the number of an accepted command that is not live, however old."""
    number = scope.removeprefix("C-")
    named = scope not in context.state.commands and scope == f"C-{number}" and number.isascii() and number.isdigit()
    return named and 0 < int(number[:18]) <= context.state.accepted


def no_target(context: DecisionContext, scope: str, asker: str = "") -> Refusal:
    """The refusal for an empty scope. `asker`: the command that named it, left out of the suggestions."""
    if has_ended(context, scope):
        return Refusal(reason=RefusalReason.STATE, message=f"{scope} has already ended")
    live = [command for command in context.state.commands if command != asker]
    known = [*(p for s in context.state.subsystems.values() for p in s.performers), *live]
    return Refusal(reason=RefusalReason.NAME, message=f"nothing live is called {scope}", expected=["ALL", *known[:20]])


def _wait_for_another(context: DecisionContext, command: Command, head: ParsedHead) -> bool:
    """Handle AFTER and TOGETHER-WITH (R116). True: the command waits, or it was refused."""
    other = head.after or head.together_with
    if other is None:
        return False
    state = context.state
    target = state.commands.get(other)
    if target is None or target is command:
        done = state.ended[other].succeeded if other in state.ended else None
        if head.after and done:
            return False
        message = (
            f"{command.id} cannot come after itself"
            if target is command
            else f"{other} has ended without success"
            if done is False
            else f"{other} has ended, it cannot be joined"
            if done
            else f"there is no command {other}"
        )
        reason = RefusalReason.NAME if target is None and done is None else RefusalReason.STATE
        clears = f"leave out {'AFTER' if head.after else 'TOGETHER-WITH'} {other}"
        refuse(context, command, Refusal(reason=reason, message=message, clears=clears))
        return True
    if command.id in _waits_for(context, target):
        message = f"{command.id} and {other} would wait for each other without end"
        refuse(context, command, Refusal(reason=RefusalReason.STATE, message=message, owner=other))
        return True
    if head.together_with and target.primitives:
        return False
    line = state.awaiting if head.after else state.joining
    line.setdefault(other, []).append(command.id)
    context.enter(command, Phase.HELD, f"waits for {other} to {'succeed' if head.after else 'begin'}")
    return True


def _waits_for(context: DecisionContext, command: Command | None) -> Collection[str]:
    """The commands that this one waits for by AFTER or TOGETHER-WITH, in a chain that starts with itself."""
    chain: dict[str, None] = {}
    while command is not None and command.id not in chain:
        chain[command.id] = None
        other = command.head and (command.head.after or command.head.together_with)
        command = context.state.commands.get(other) if other else None
    return chain


def on_released(context: DecisionContext, command: Command, begun_or_succeeded: bool) -> None:
    if begun_or_succeeded:
        claim_and_elaborate(context, command)
        return
    assert command.head is not None
    other = command.head.after or command.head.together_with
    what = "ended without success" if command.head.after else "ended before it began to move"
    refuse(context, command, Refusal(reason=RefusalReason.STATE, message=f"{other} {what}", owner=other or ""))


# --- elaborated, held --------------------------------------------------------------------------------


def _named(context: DecisionContext, head: ParsedHead) -> Claim:
    """The claim of the names in the sentence: hands exclusively, the object shared against changes by others."""
    claim: Claim = {}
    if head.kind == "task":
        if head.object:
            claim[head.object] = False
        for hand in (head.hand, head.to_hand):
            if hand == "BOTH-ARMS":
                claim.update({p: True for s in context.state.subsystems.values() for p in s.performers})
            elif hand:
                claim[hand] = True
    return claim


def claim_and_elaborate(context: DecisionContext, command: Command) -> None:
    """Claim the named resources, then elaborate, so that no other command changes the facts of the plan."""
    assert command.head is not None
    if claim_or_wait(context, command, _named(context, command.head)):
        elaborate(context, command)


def claim_or_wait(context: DecisionContext, command: Command, claim: Claim) -> bool:
    """True: the claim is granted. False: the command waits in line, or was refused because of NOW."""
    assert command.head is not None
    resources = context.state.resources
    result = resources.take(command.id, claim)
    if isinstance(result, list):
        context.grant(result)
        return True
    name, owner = result
    if command.head.now:
        message = f"{name} is in use by {owner}, and the sentence contains NOW"
        clears = f"wait for {owner}, abort it, or leave out NOW"
        refuse(context, command, Refusal(reason=RefusalReason.RESOURCE, message=message, owner=owner, clears=clears))
        return False
    context.grant(resources.wait(command.id, claim))
    context.enter(command, Phase.HELD, f"{name} is in use by {owner}")
    return False


def on_granted(context: DecisionContext, command: Command, _: Any) -> None:
    """Take the granted claim and elaborate again, because the world may have changed during the wait."""
    resources = context.state.resources
    result = resources.take(command.id, resources.waiting.get(command.id, {}))
    if isinstance(result, list):
        context.grant(result)
        elaborate(context, command)


def elaborate(context: DecisionContext, command: Command) -> None:
    command.elaborations += 1
    if command.elaborations > MAX_ELABORATIONS:
        message = f"its claim changed {MAX_ELABORATIONS} times while it waited for it"
        refuse(context, command, Refusal(reason=RefusalReason.OVERLOAD, message=message))
        return
    context.create_job(command, WorkerKind.ELABORATOR, {"command": command.id, "parsed": command.parsed})
    context.enter(command, Phase.ELABORATING)


def on_elaborated(context: DecisionContext, command: Command, product: msgspec.Raw) -> None:
    script = read_script(product)
    claim: Claim = dict.fromkeys(script.reads, False)
    claim.update(dict.fromkeys(script.resources, True))
    claim.update(dict.fromkeys(script.writes, True))
    halted = [r for r in script.resources if context.state.halted_at_s.get(r, -1.0) > command.given_at_s]
    if halted:
        message = f"{halted[0]} was halted after this command was given"
        end(context, command, OutcomeKind.HALTED, message=message, stop=StopReason.HALT)
        return
    if not claim_or_wait(context, command, claim):
        return
    command.actions = action_stack.begin(script)
    command.labels = [read_step(step).label for step in script.steps]
    if script.notes:
        context.note(command, "; ".join(script.notes))
    next_step(context, command)


# --- bound, executing --------------------------------------------------------------------------------


def next_step(context: DecisionContext, command: Command) -> None:
    """Bind the top of the Action_Stack, or end the command if the stack is empty (paper, main loop)."""
    actions = command.actions
    assert actions is not None
    if not actions.refs and command.given_up is not None:
        end_given_up(context, command)
    elif not actions.refs:
        end(context, command, OutcomeKind.SUCCEEDED)
    elif command.pause_wanted:
        context.enter(command, Phase.PAUSED, "paused between two steps")
    else:
        actions.pop()
        command.step_words = step_in_words(command)
        name = primitive_id(command.id, command.primitives + 1, context.state.life)
        context.create_job(command, WorkerKind.BINDER, actions.binder_input(name))
        context.enter(command, Phase.BINDING)


def on_bound(context: DecisionContext, command: Command, product: msgspec.Raw) -> None:
    assert command.actions is not None
    result = read_bound(product)
    command.actions.assign(result.bindings)
    if result.report != NIL:
        command.evaluation = result.evaluation
        analyze(context, command, result.report)
        context.enter(command, Phase.ANALYZING, result.note)
        return
    if not result.subsystem or result.primitive == NIL:
        command.steps_done += 1
        context.note(command, result.note or "nothing to execute")
        next_step(context, command)
        return
    subsystem = context.state.subsystems.get(result.subsystem)
    if subsystem is None or subsystem.link is Link.LOST:
        lost = f"{result.subsystem} is not connected; this step moved nothing: give the sentence again when it is back"
        end(context, command, OutcomeKind.LOST_SUBSYSTEM, message=lost, stop=StopReason.SUBSYSTEM_LOST)
        return
    primitive = read_primitive(result.primitive)
    if not context.state.resources.held.get(command.id, {}).get(primitive.performer):
        message = f"the step moves {primitive.performer}, which its script has not claimed"
        refuse(context, command, Refusal(reason=RefusalReason.PROGRAM, message=message, where=command.step_words))
        return
    if not belongs_to(primitive.id, command.id, command.primitives + 1, context.state.life):
        message = f"the binder made a primitive called {primitive.id[:40]!r}, which is not the next one of {command.id}"
        refuse(context, command, Refusal(reason=RefusalReason.PROGRAM, message=message, where=command.step_words))
        return
    if result.evaluation == NIL:
        message = "the binder made a primitive without an evaluation for the analyzer"
        refuse(context, command, Refusal(reason=RefusalReason.PROGRAM, message=message, where=command.step_words))
        return
    command.primitives += 1
    command.primitive = primitive.id
    command.primitive_body = result.primitive
    command.performers = [primitive.performer]
    command.subsystem = result.subsystem
    command.evaluation = result.evaluation
    command.limit_s = result.limit_s
    send(context, command)
    context.enter(command, Phase.EXECUTING, result.note, expected_s=result.predicted_s * context.state.timeout_scale)
    if command.primitives == 1:
        for waiting in context.state.joining.pop(command.id, ()):
            context.follow(waiting, Stimulus.RELEASE, True)


def send(context: DecisionContext, command: Command) -> None:
    """Send the primitive to its subsystem, which is responsible for it from now on (R58); the broker watches the time
    limit only. An awaited subsystem receives it when it reconnects."""
    command.sent_at_s = context.now
    command.at_rest = False
    subsystem = context.state.subsystems[command.subsystem]
    if subsystem.link is Link.CONNECTED:
        context.effects.append(
            SendPrimitive(
                subsystem=command.subsystem,
                id=command.primitive,
                primitive=command.primitive_body,
                issued_at_s=context.now,
                pid=subsystem.pid,
            )
        )
    context.start_timer(command, report_limit_s(context.state, command))


def on_reported(context: DecisionContext, command: Command, report: EndReport) -> None:
    context.stop_timer(command)
    acknowledge(context, command)
    command.measured = reporting.at_end(command, report)
    note = f"ended: {report.reason.value}" + (f" ({report.message})" if report.message else "")
    if report.reason is StopReason.HALT:
        command.pending_outcome = PendingOutcome(
            kind=OutcomeKind.HALTED, message="halted at its subsystem", stop=StopReason.HALT
        )
        close(context, command, report, note)
        return
    analyze(context, command, report)
    context.enter(command, Phase.ANALYZING, note, measured=command.measured)


def acknowledge(context: DecisionContext, command: Command) -> None:
    """Acknowledge the end report. Effects follow the journal, so the report is not needed again."""
    context.effects.append(AcknowledgeReport(subsystem=command.subsystem, primitive=command.primitive))
    command.primitive_body = NIL
    command.at_rest = True


def analyze(context: DecisionContext, command: Command, report: EndReport | msgspec.Raw) -> None:
    assert command.actions is not None
    data = command.actions.analyzer_input(command.evaluation, report)
    context.create_job(command, WorkerKind.ANALYZER, data, locations=command.actions.script.writes)


# --- analysed ----------------------------------------------------------------------------------------


def on_assessed(context: DecisionContext, command: Command, product: msgspec.Raw) -> None:
    assert command.actions is not None
    assessment = read_assessment(product)
    command.actions.assign(assessment.keep)
    if assessment.verdict == "continue":
        command.steps_done += 1
        context.note(command, assessment.message or f"{assessment.reason.value}: as expected")
        next_step(context, command)
    elif assessment.verdict == "trim" and push_trim(context, command, assessment):
        next_step(context, command)
    elif command.given_up is not None:
        end_given_up(context, command, assessment.message)
    else:
        failed = failure(assessment)
        end(context, command, failed.kind, message=failed.message, stop=failed.stop, refusal=failed.refusal)


def failure(assessment: AssessmentHead) -> PendingOutcome:
    """The outcome after a step without a usable trim."""
    message = assessment.message or f"{assessment.reason.value} where it was not expected"
    refusal = None
    if assessment.clears:
        refusal = Refusal(reason=RefusalReason.STATE, message=message, clears=assessment.clears)
    return PendingOutcome(kind=OutcomeKind.FAILED, message=message, stop=assessment.reason, refusal=refusal)


def push_trim(context: DecisionContext, command: Command, assessment: AssessmentHead) -> bool:
    """Continue with the steps of the trim that the analyzer proposes. False: the trim is not allowed."""
    assert command.actions is not None
    trim = command.actions.push_trim(assessment.trim)
    if trim is None:
        return False
    context.count("trims")
    if trim.then == "give_up":
        command.given_up = failure(assessment)
    context.note(command, f"{assessment.message or assessment.reason.value}: trim {trim.n}, {trim.label}")
    return True


# --- pause and resume --------------------------------------------------------------------------------


def request_pause(context: DecisionContext, command: Command, _: Any) -> None:
    command.pause_wanted = True
    context.note(command, "will pause before its next step")


def withdraw_pause(context: DecisionContext, command: Command, _: Any) -> None:
    command.pause_wanted = False


def resume(context: DecisionContext, command: Command, _: Any) -> None:
    command.pause_wanted = False
    context.note(command, "resumed")
    next_step(context, command)

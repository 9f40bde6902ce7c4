"""TEST sentences: one job of a rehearser, then the end; and sentences that are given because their test passed. Pure.

The digest of a test names the whole list of sentences so far, with the facts and programs that it rests on. So it also
names the world after them, in which the next sentence of the list is rehearsed.
"""

from __future__ import annotations

import msgspec

from broker.decisions.command.claims import without_now
from broker.decisions.command.scope import scope_of
from broker.decisions.command.termination import end, refuse
from broker.decisions.context import DecisionContext
from broker.decisions.state import (
    Command,
    JobKind,
    ParsedHead,
    PendingOutcome,
    RehearsedHead,
    State,
    Tested,
    exact_arms_of,
    picture_times_of,
)
from rtc.protocol import wire
from rtc.protocol.advice import by_person
from rtc.protocol.digest import digest
from rtc.protocol.messages import Paper, Phase, RehearsalInput, RestsOn, WorkerKind
from rtc.protocol.outcomes import OutcomeKind, Refusal, RefusalReason
from rtc.protocol.sentence import ParsedCommand

TESTS_KEPT = 512  # latest tests whose digests are known
GIVEN_KEPT = 100  # latest commands given for one test: what they change is foreseen
TEST_AGAIN = "test the sentences again: rtc test"

read_rehearsed = wire.decoder(RehearsedHead)


def rehearse(context: DecisionContext, command: Command, head: ParsedHead) -> None:
    """Begin with a TEST sentence. It claims nothing and waits for nothing: it uses the facts as they are."""
    before = context.state.tested.get(command.after_test)
    if command.after_test and before is None:
        refuse(context, command, _unknown(command.after_test))
        return
    named = (head.after, head.together_with, scope_of(head) if head.kind == "control" else None)
    known = {
        *context.state.commands,
        *([head.after] if head.after and _has_succeeded(context.state, head.after) else []),
    }
    data = RehearsalInput(
        command=command.id,
        text=command.text,
        parsed=wire.opaque(command.parsed, ParsedCommand),
        label=command.label,
        live=[name for name in named if name in known],
        at_s=context.now,
        moving=context.motions_beside(command),
        rigid=exact_arms_of(context.state),
        pictures=picture_times_of(context.state),
        before=None if before is None else wire.opaque(before.paper, Paper),
    )
    context.create_job(command, WorkerKind.ELABORATOR, data, kind=JobKind.REHEARSAL)
    context.enter(command, Phase.REHEARSING)


def _has_succeeded(state: State, name: str) -> bool:
    return name in state.ended and state.ended[name].succeeded


def on_rehearsed(context: DecisionContext, command: Command, product: msgspec.Raw) -> None:
    """End a TEST sentence with what its rehearsal has found, and keep that under its digest."""
    assert command.head is not None
    result = read_rehearsed(product)
    holders = context.state.resources.holders
    in_use = {name: next(iter(holders[name])) for name in result.rehearsal.resources if name in holders}
    refusal = result.refusal or _refuse_now(command.head, in_use)
    name = _keep(context.state, command, result, feasible=refusal is None)
    rehearsal = msgspec.structs.replace(result.rehearsal, digest=name, in_use=in_use)
    command.step_text = result.step
    if refusal is None:
        lasts = any(step.until_stopped for step in rehearsal.steps)
        message = "feasible, until it is stopped" if lasts else f"feasible, about {rehearsal.predicted_s:.1f} s"
        message += f": {rehearsal.remark}" if rehearsal.remark else ""
        end(context, command, PendingOutcome(OutcomeKind.SUCCEEDED, message, rehearsal=rehearsal))
    else:
        end(
            context,
            command,
            PendingOutcome(OutcomeKind.REFUSED, refusal.message, refusal=refusal, rehearsal=rehearsal),
        )


def _refuse_now(head: ParsedHead, in_use: dict[str, str]) -> Refusal | None:
    if not head.now or not in_use:
        return None
    name, owner = next(iter(in_use.items()))
    message = f"{name} is in use by {owner}, and the sentence contains NOW"
    clears = without_now(owner)
    return Refusal(reason=RefusalReason.RESOURCE, message=message, owner=owner, clears=clears)


def _keep(state: State, command: Command, result: RehearsedHead, *, feasible: bool) -> str:
    """Store a test; returns its digest."""
    rehearsal = result.rehearsal
    rests_on = (rehearsal.relies_on, rehearsal.foreseen, command.programs)
    name = digest(wire.encode((command.after_test, result.parsed, feasible, rests_on)))[:12]
    given = state.tested.pop(name).given if name in state.tested else []
    state.tested[name] = Tested(
        before=command.after_test,
        record=result.parsed,
        feasible=feasible,
        relies_on=rehearsal.relies_on,
        foreseen=rehearsal.foreseen,
        programs=command.programs,
        paper=result.after,
        given=given,
    )
    while len(state.tested) > TESTS_KEPT:
        del state.tested[next(iter(state.tested))]
    return name


def _unknown(name: str) -> Refusal:
    return Refusal(
        reason=RefusalReason.STALE,
        message=f"no test {name} is known; the cluster keeps the {TESTS_KEPT} latest",
        where=name,
        clears=by_person(TEST_AGAIN),
    )


# --- sentences of a test ---------------------------------------------------------------------------------


def why_not_as_tested(context: DecisionContext, command: Command) -> Refusal | None:
    """Why a sentence may not be performed on the strength of its test, as far as the Decision Unit knows; None if it
    may. The elaborator compares the facts."""
    state, name = context.state, command.if_tested
    if name not in state.tested:
        return _unknown(name)
    tests = _list_of(state, name)
    of_sentence = [test for test in tests if bytes(test.record) == bytes(command.parsed)]
    if not of_sentence:
        message = f"this sentence is not one of the test {name}"
        return Refusal(reason=RefusalReason.STALE, message=message, where=name, clears=by_person(TEST_AGAIN))
    test = min(of_sentence, key=lambda one: len(one.given))  # a list may contain a sentence twice
    if not test.feasible:
        message = f"this sentence was not feasible in the test {name}"
        return Refusal(
            reason=RefusalReason.STALE, message=message, where=name, clears=by_person("`rtc test` names what to change")
        )
    if changed := [kind for kind, program in command.programs.items() if test.programs.get(kind) != program]:
        message = f"the {changed[0]} has another program than in the test {name}"
        return Refusal(reason=RefusalReason.STALE, message=message, where=changed[0], clears=by_person(TEST_AGAIN))
    given = [other for one in tests[: tests.index(test)] for other in one.given]  # of the sentences before it
    command.rests_on = RestsOn(test=name, relies_on=test.relies_on, foreseen=test.foreseen, given=given)
    test.given.append(command.id)
    del test.given[:-GIVEN_KEPT]
    return None


def _list_of(state: State, name: str) -> list[Tested]:
    """The tests of the list that a digest names, as far as they are known, in order."""
    found: list[Tested] = []
    while (test := state.tested.get(name)) is not None:
        found.append(test)
        name = test.before
    return found[::-1]

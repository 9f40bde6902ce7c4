"""Following an advice as a person would who does what it says, and no more.

Of its alternatives the first one that succeeds is done, sentence by sentence. An operator who looks sees: a fact that
an alternative `states` is stated as it truly is. A sentence with the verb and object of that on which the advice was
given, such as that for the rest of an amount, takes its place. One with a smaller distance of AVOID-NEIGHBORS is given
from then on. A sentence of which nothing is left is not given again: what is advised then frees the arm. Nor is one
given again after a sentence that is advised `instead` of it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Literal, NamedTuple

from msgspec.structs import replace

from broker.decisions.command.nominal import failure
from rtc.protocol.advice import Advice, Alternative
from rtc.protocol.causes import AlreadyDone
from rtc.protocol.outcomes import Outcome, OutcomeKind, Refusal
from rtc.protocol.sentence import OPERATOR, ParsedCommand
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line
from tests.workers.conftest import GRAMMAR, Bench, Run
from tests.workers.one_process import OneProcess
from workers.parser.parse import parse_job

NOTHING_LEFT = "nothing is left of it"
MAX_SENTENCES = 4  # for one obstacle
MAX_OBSTACLES = 4
LIMIT_S = 600.0  # of one sentence, in the time of the simulation
NEIGHBORS = "AVOID-NEIGHBORS"
OWN = ("task", "data")  # kinds of sentences that are followed: none about other commands, and none for the operator

Truth = Callable[[], dict[str, Any]]  # poses of objects (`poses`) and of seats (`seats`), world frame


class Answer(NamedTuple):
    """What a sentence came to."""

    succeeded: bool
    message: str
    clears: Sequence[Alternative] = ()
    done: bool = False  # nothing is left of the sentence

    @classmethod
    def of(cls, run: Run) -> Answer:
        failed = run.failure
        why = failure(failed).refusal if failed else run.refusal
        message = "; ".join(filter(None, (failed.message, failed.remark))) if failed else why.message if why else ""
        return cls(run.succeeded, message, why.clears if why else [], _is_done(message, why))

    @classmethod
    def of_outcome(cls, outcome: Outcome) -> Answer:
        why = outcome.refusal
        done = _is_done(outcome.message, why)
        return cls(outcome.kind is OutcomeKind.SUCCEEDED, outcome.message, why.clears if why else [], done)

    def __str__(self) -> str:
        return "succeeded" if self.succeeded else f"{self.message} [{in_one_line(self.clears)}]"


def _is_done(message: str, why: Refusal | None) -> bool:
    return message.endswith(NOTHING_LEFT) or (why is not None and isinstance(why.cause, AlreadyDone))


class Followed(NamedTuple):
    """`instead`: what was advised instead is done. `no sentence`: the advice has none. `same advice`: it was given
    before, so it does not lead out."""

    end: Literal["reached", "instead", "no sentence", "same advice", "too many obstacles"]
    given: list[str]
    history: list[str]


def first(advice: Iterable[Alternative], given: str, truth: Truth) -> list[str]:
    """The sentences of the first alternative of an advice that has one, with the `given` one if it comes again."""
    options = ([*sentences(one, truth), *([given] if one.again else [])] for one in advice)
    return next(filter(None, options), [])


def sentences(one: Alternative, truth: Truth) -> list[str]:
    """The sentences of an alternative, those that state a fact as it truly is; none for a person who performs it."""
    found: list[str] = []
    open_keys = [*one.states]
    for text in one.sentences:
        parsed = _parsed(text)
        if parsed is None or parsed.kind not in OWN or parsed.performer == OPERATOR:
            return []
        key = f"{parsed.object}.{(parsed.attribute or '').lower()}"
        states = key in open_keys
        found.append((states and stated_fact(key, truth)) or text)
        open_keys = [other for other in open_keys if other != key]
    return [*filter(None, (stated_fact(key, truth) for key in open_keys)), *found]


def follow(say: Callable[[str], Answer], aim: str, answer: Answer, truth: Truth) -> Followed:
    """Clear one obstacle after the other that a sentence, the aim, meets; `answer` is its first one.

    The aim is given after at most four sentences.
    """
    given: list[str] = []
    history, advised = [f"{aim}: {answer}"], [_asked(answer.clears)]
    for _ in range(MAX_OBSTACLES):
        closer = next((text for one in answer.clears if (text := _closer(one, aim))), "")
        tried: dict[str, bool] = {}
        for one in [] if closer else answer.clears:
            todo = sentences(one, truth)
            if not todo or not all(tried.get(text, True) for text in todo):
                continue
            for text in [text for text in todo if text not in tried][: MAX_SENTENCES - len(tried)]:
                given.append(text)
                done = say(text)
                history.append(f"{text}: {done}")
                tried[text] = done.succeeded
                if done.succeeded and _takes_its_place(text, aim):
                    return Followed("reached", given, history)
            if all(tried.get(text, False) for text in todo):
                if one.instead:
                    return Followed("instead", given, history)
                break
        if answer.done:
            return Followed("reached", given, history)
        if closer:
            aim = closer
        elif not tried and not any(one.again for one in answer.clears):
            return Followed("no sentence", given, history)
        answer = say(aim)
        history.append(f"again: {answer}")
        if answer.succeeded:
            return Followed("reached", given, history)
        if (asked := _asked(answer.clears)) in advised:
            return Followed("same advice", given, history)
        advised.append(asked)
    return Followed("too many obstacles", given, history)


def _asked(advice: Iterable[Alternative]) -> Advice:
    return [one for one in advice if one.sentences or one.states or one.again]


def _closer(one: Alternative, aim: str) -> str:
    """The aim with another AVOID-NEIGHBORS, if that is what the alternative is."""
    if not one.instead or len(one.sentences) != 1:
        return ""
    asked, now = _parsed(one.sentences[0]), _parsed(aim)
    if asked is None or now is None or not any(item.slot == NEIGHBORS for item in asked.constraints):
        return ""
    others = [[item for item in each.constraints if item.slot != NEIGHBORS] for each in (asked, now)]
    same = replace(asked, constraints=[]) == replace(now, constraints=[], report=None) and others[0] == others[1]
    return one.sentences[0] if same else ""


def is_own(text: str) -> bool:
    parsed = _parsed(text)
    return parsed is not None and parsed.kind in OWN


def _parsed(text: str) -> ParsedCommand | None:
    parsed = parse_job(GRAMMAR, text)
    return parsed if isinstance(parsed, ParsedCommand) else None


def _takes_its_place(sentence: str, aim: str) -> bool:
    """Whether an advised sentence does what the aim should: the same to the same, by what is left or another way."""
    return sentence.split()[:2] == aim.split()[:2] and (" BY " in aim or aim in sentence)


def follow_on_bench(bench: Bench, aim: str, done: Run) -> Followed:
    """Follow the advice of a sentence that has not succeeded on a bench with physics."""
    return follow(lambda text: Answer.of(bench.do(text)), aim, Answer.of(done), bench.subsystem.sim.truth)


def follow_in_cluster(cluster: OneProcess, aim: str, outcome: Outcome) -> Followed:
    """Follow the advice of a command that has not succeeded in a cluster without any other command."""

    def say(sentence: str) -> Answer:
        command = cluster.give(sentence)
        cluster.run(LIMIT_S)
        return Answer.of_outcome(cluster.outcomes[command])

    return follow(say, aim, Answer.of_outcome(outcome), cluster.sim.truth)


def summary(ends: Iterable[str]) -> tuple[dict[str, float | None], tuple[str, str]]:
    """The metric and the row of a report on what followed advice came to (`Followed.end`)."""
    counts = Counter(ends)
    text = "; ".join(f"{n} {end}" for end, n in counts.most_common()) or "none was given"
    return {"advice_same_twice": float(counts["same advice"])}, ("advice of refusals and failures, followed", text)


def stated_fact(key: str, truth: Truth) -> str:
    """The sentence that states the truth about a fact; empty if there is none."""
    name, _, attribute = key.rpartition(".")
    if attribute == "frame":
        return stated(name, truth())
    return state_of(name, truth()) if attribute == "state" else ""


def stated(name: str, truth: dict[str, Any]) -> str:
    """The sentence that states the true pose of an object or seat; empty if there is none."""
    pose = (truth["poses"] | truth["seats"]).get(name)
    if pose is None:
        return ""
    metres = " ".join(f"{100.0 * x:.2f}" for x in pose[:3])
    degrees = " ".join(f"{math.degrees(x):.2f}" for x in geometry.to_rpy(pose))
    return f"SET {name} FRAME {metres} CM {degrees} DEG"


def state_of(bolt: str, truth: dict[str, Any]) -> str:
    """The sentence that states whether a bolt is tight or loose; empty if it is neither, or not known."""
    turns, all_turns = truth.get("turns", {}).get(bolt, (math.nan, math.nan))
    state = "TIGHT" if turns < 0.05 else "LOOSE" if turns > all_turns - 0.05 else ""
    return f"SET {bolt} STATE {state}" if state else ""

"""Following an advice as a person would who does what it says, and no more.

An advice has steps (`; ` or `, then ` between them), and a step has alternatives (`or`). An operator who looks sees:
`SET X FRAME x y z` and `SET X STATE LOOSE or TIGHT` state the truth. `do it again` is the sentence on which the advice
was given; a sentence with its verb and object, such as that for the rest of an amount, takes its place. A smaller
distance of AVOID-NEIGHBORS is put into that sentence, and no other advice is followed. A sentence of which nothing is
left is not given again: what is advised then frees the arm. Nor is one given again after a sentence that is advised
`instead` of it.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any, Literal, NamedTuple

from broker.decisions.command.nominal import failure
from rtc.protocol.causes import AlreadyDone
from rtc.protocol.outcomes import Outcome, OutcomeKind, Refusal
from rtc.protocol.sentence import OPERATOR, ParsedCommand
from rtc.spatial import geometry
from tests.workers.conftest import GRAMMAR, Bench, Run
from tests.workers.one_process import OneProcess
from workers.parser.parse import parse_job

NOTHING_LEFT = "nothing is left of it"
MAX_SENTENCES = 4  # for one obstacle
MAX_OBSTACLES = 4
LIMIT_S = 600.0  # of one sentence, in the time of the simulation

VERBS = "LOCATE|LIFT|RETRACT|RELEASE|VERIFY|OPEN|CLOSE|STOW|MOVE|GRASP|PLACE|INSERT|SET|APPROACH|HOLD|TRACK"
VERBS += "|CARRY|TURN|PUSH|PULL|LOOSEN|TIGHTEN|EXTRACT|ALIGN"
WORD = r"(?:[A-Z][A-Z0-9-]*|-?\d+(?:\.\d+)?)"
SENTENCE = re.compile(rf"\b(?:{VERBS})(?: {WORD})+")
ELSEWHERE = re.compile(r"MOVE (.+?) TO another place first \(([A-Z0-9-]+)")
ANYWHERE = re.compile(r"MOVE ([A-Z0-9-]+) to a place")
AGAIN = re.compile(r"\b(?:do it|try|give (?:it|the sentence|the command)) again")
OTHER_ARM = re.compile(r"move (.+?) away first")
CLOSER = re.compile(r"\b(AVOID-NEIGHBORS BY \S+ \S+), (?:or leave it out|if it may come as near)")
NEIGHBORS = re.compile(r"\bAVOID-NEIGHBORS(?: BY \S+ \S+)?")
CLAUSES = re.compile(r" MAINTAIN | (?=UNLESS|UNTIL|VIA|GUARDED|AFTER|TOGETHER-WITH|NOW)|$")
STATED = re.compile(r"SET ([A-Z0-9-]+) (FRAME|ANGLE|STATE)")
STEPS = re.compile(r"; |, then ")
NUMBERED = re.compile(r"^as for C-\d+: |; rtc why C-\d+ .*$|C-\d+")  # says who got the same advice before
ALTERNATIVES = re.compile(r", or | or (?=[A-Z]{3})")

Truth = Callable[[], dict[str, Any]]  # poses of objects (`poses`) and of seats (`seats`), world frame


class Answer(NamedTuple):
    """What a sentence came to."""

    succeeded: bool
    message: str
    clears: str
    done: bool = False  # nothing is left of the sentence

    @classmethod
    def of(cls, run: Run) -> Answer:
        failed = run.failure
        why = failure(failed).refusal if failed else run.refusal
        message = "; ".join(filter(None, (failed.message, failed.remark))) if failed else why.message if why else ""
        return cls(run.succeeded, message, why.clears if why else "", _is_done(message, why))

    @classmethod
    def of_outcome(cls, outcome: Outcome) -> Answer:
        why = outcome.refusal
        done = _is_done(outcome.message, why)
        return cls(outcome.kind is OutcomeKind.SUCCEEDED, outcome.message, why.clears if why else "", done)

    def __str__(self) -> str:
        return "succeeded" if self.succeeded else f"{self.message} [{self.clears}]"


def _is_done(message: str, why: Refusal | None) -> bool:
    return message.endswith(NOTHING_LEFT) or (why is not None and isinstance(why.cause, AlreadyDone))


class Followed(NamedTuple):
    """`instead`: what was advised instead is done. `no sentence`: the advice has none. `same advice`: it was given
    before, so it does not lead out."""

    end: Literal["reached", "instead", "no sentence", "same advice", "too many obstacles"]
    given: list[str]
    history: list[str]


def steps(advice: str, given: str, truth: Truth) -> list[list[str]]:
    """The sentences of an advice on the `given` one: the steps in their order, each with its alternatives."""
    found: list[list[str]] = []
    for part in STEPS.split(advice):
        options = ALTERNATIVES.split(part.removeprefix("or "))
        sentences = [given if AGAIN.search(one) else _sentence(one, truth) for one in options]
        sentences = [one for one in sentences if one]
        if part.startswith("or ") and found:
            found[-1] += sentences  # alternatives to what precedes it
        elif sentences:
            found.append(sentences)
    return found


def follow(say: Callable[[str], Answer], aim: str, answer: Answer, truth: Truth) -> Followed:
    """Clear one obstacle after the other that a sentence, the aim, meets; `answer` is its first one.

    Each step is done if one of its alternatives succeeds; the aim is given after at most four sentences.
    """
    given: list[str] = []
    history, advised = [f"{aim}: {answer}"], {NUMBERED.sub("", answer.clears)}
    for _ in range(MAX_OBSTACLES):
        advice, left = answer.clears, MAX_SENTENCES
        closer = CLOSER.search(advice)
        for step in [] if closer else steps(advice, "", truth):
            for sentence in step[:left]:
                left -= 1
                given.append(sentence)
                done = say(sentence)
                history.append(f"{sentence}: {done}")
                if done.succeeded and _takes_its_place(sentence, aim):
                    return Followed("reached", given, history)
                if done.succeeded and _is_instead(sentence, advice, truth):
                    return Followed("instead", given, history)
                if done.succeeded:
                    break
        if answer.done:
            return Followed("reached", given, history)
        if closer:
            aim = _kept_apart(aim, closer[1])
        elif left == MAX_SENTENCES and not AGAIN.search(advice):
            return Followed("no sentence", given, history)
        answer = say(aim)
        history.append(f"again: {answer}")
        if answer.succeeded:
            return Followed("reached", given, history)
        if (words := NUMBERED.sub("", answer.clears)) in advised:
            return Followed("same advice", given, history)
        advised.add(words)
    return Followed("too many obstacles", given, history)


def _is_instead(sentence: str, advice: str, truth: Truth) -> bool:
    """Whether the advice has this sentence in the place of the aim: it is not given again then."""
    options = (one for part in STEPS.split(advice) for one in ALTERNATIVES.split(part.removeprefix("or ")))
    return any(re.search(r"\binstead\b", one) and _sentence(one, truth) == sentence for one in options)


def _takes_its_place(sentence: str, aim: str) -> bool:
    """Whether an advised sentence does what the aim should: the same to the same, by what is left or another way."""
    return sentence.split()[:2] == aim.split()[:2] and (" BY " in aim or aim in sentence)


def _kept_apart(sentence: str, by: str) -> str:
    """The sentence with this item of MAINTAIN."""
    if NEIGHBORS.search(sentence):
        return NEIGHBORS.sub(by, sentence)
    first = CLAUSES.search(sentence)
    assert first is not None
    more = " AND " if "MAINTAIN" in first[0] else " "
    return f"{sentence[: first.start()]} MAINTAIN {by}{more}{sentence[first.end() :]}".rstrip()


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


def _sentence(text: str, truth: Truth) -> str:
    if other := OTHER_ARM.search(text):
        return f"STOW {other[1]}"
    if anywhere := ANYWHERE.search(text):
        return f"MOVE {anywhere[1]} TO CLEAR-POINT-1"
    if elsewhere := ELSEWHERE.search(text):
        return f"MOVE {elsewhere[1]} TO {elsewhere[2]}"
    if (about := STATED.search(text)) and about[2] == "FRAME":
        return stated(about[1], truth())
    if about and about[2] == "STATE":
        return state_of(about[1], truth())
    if OPERATOR in text:  # no person performs it here
        return ""
    sentence = SENTENCE.search(text)
    return sentence[0] if sentence and isinstance(parse_job(GRAMMAR, sentence[0]), ParsedCommand) else ""


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

"""Does a sentence lead on after a pause of an hour, and after an operator who has left?

A command is paused in its motion for an hour, or an operator has an arm, moves it and leaves: the page is closed with
the deadman held, or let go without a word, or the grant is ended by another one. An hour later a second person says
a sentence. What waits says what it waits for, and what ends that; this is followed literally, and so is the advice of
what fails (`tests.campaigns.advice`). A run is done if the sentence succeeds within four sentences, and free if its arm
does. Arms of exact kinematics, with Decision Unit, workers and MCM in one process; no tick passes in the hour.

    python -m tests.campaigns.left_alone [--runs 100] [--only 17]
"""

from __future__ import annotations

import copy
from collections import Counter
from functools import cache
from typing import Any, Literal, NamedTuple

import numpy as np

from benchmarks.grasp import wilson
from benchmarks.report import question
from rtc.protocol import messages as m
from rtc.protocol.outcomes import OutcomeKind
from rtc.subsystems.motion.arm import TICK_S, CellState
from rtc.wording.notes import in_words
from rtc.world.model import World
from sim_mcm.arms.kinematic_arm import KinematicCell
from tests.campaigns import advice, numbered_runs
from tests.campaigns.advice import Answer
from tests.workers.conftest import CELL, MODEL
from tests.workers.eyes import Ideal
from tests.workers.one_process import OneProcess

SEED = 43
HOUR = round(3600.0 / TICK_S)  # ticks
LIMIT = round(600.0 / TICK_S)  # ticks of one sentence
IDLE = round(1.0 / TICK_S)
WAITS = round(2.0 / TICK_S)  # ticks without motion after which a command is seen to wait: a look takes less
PERIOD = 20  # ticks between two messages of a hand
FEWEST = 100  # runs whose results are kept
ATTEMPTS = 20  # sentences that end before they are paused are drawn anew

ARMS = {"RIGHT-ARM": ("MACS-NEW", "HANDLE-A"), "LEFT-ARM": ("MACS-OLD", "HANDLE-B")}
LED = {"home": (), "lifted": ("GRASP {module} {handle} WITH {arm}", "LIFT {module} BY 20 CM WITH {arm}")}
MOTIONS = {
    "home": (
        *("STOW {arm}", "GRASP {module} {handle} WITH {arm}", "APPROACH {module} AT {handle} WITH {arm}"),
        *("MOVE {arm} TO CLEAR-POINT-1", "MOVE {arm} BY {cm} CM ALONG {axis}"),
    ),
    "lifted": (
        *("CARRY {module} TO CLEAR-POINT-1", "MOVE {arm} TO CLEAR-POINT-1", "MOVE {arm} BY {cm} CM ALONG {axis}"),
        *("LIFT {module} BY {cm} CM WITH {arm}", "STOW {arm}"),
    ),
}
BY_HAND = {
    "home": (
        *("GIVE {arm} TO OPERATOR", "MOVE {arm} TO CLEAR-POINT-1 MAINTAIN SHARED WRIST"),
        "GRASP {module} {handle} WITH {arm} VIA OPERATOR-INTERVENTION",
    ),
    "lifted": ("GIVE {arm} TO OPERATOR", "MOVE {arm} TO CLEAR-POINT-1 MAINTAIN SHARED VIA OPERATOR-INTERVENTION"),
}
LATER = ("STOW {arm}", "STOW {other}", "MOVE {arm} TO CLEAR-POINT-1", "RETRACT {arm} BY 5 CM")
PAUSED_THEN = ("RESUME", "ABORT", "HALT", "another sentence")
LEAVES = ("page closed", "lets go", "taken", "halted", "CANNOT", "the MCM dies")


class Drawn(NamedTuple):
    what: Literal["pause", "operator"]
    start: str
    arm: str
    sentence: str
    later: str  # the sentence an hour later
    then: str  # of PAUSED_THEN or LEAVES
    after_s: float  # the start of the motion
    twist: list[float]  # of the operator


class Ran(NamedTuple):
    drawn: Drawn
    end: Literal["done", "free", "stuck"]
    why: str
    given: int  # sentences
    story: list[str]


@cache
def _known(start: str, arm: str) -> tuple[World, CellState]:
    cluster = OneProcess(KinematicCell(CELL), eyes=Ideal(CELL))
    for sentence in LED[start]:
        command = cluster.give(sentence.format(**_names(arm)))
        cluster.run(600.0)
        assert cluster.outcomes[command].kind is OutcomeKind.SUCCEEDED, (sentence, cluster.outcomes[command])
    return cluster.world, cluster.sim.state()


def _at(start: str, arm: str) -> OneProcess:
    world, state = _known(start, arm)
    sim = KinematicCell(CELL)
    sim.restore(copy.deepcopy(state))
    return OneProcess(sim, MODEL, world, Ideal(CELL))


def _names(arm: str) -> dict[str, str]:
    module, handle = ARMS[arm]
    return {"arm": arm, "other": next(one for one in ARMS if one != arm), "module": module, "handle": handle}


def draw(random: np.random.Generator, what: Literal["pause", "operator"]) -> Drawn:
    start, arm = str(random.choice(list(LED))), str(random.choice(list(ARMS)))
    figures = {"cm": f"{random.choice([-1, 1]) * random.uniform(4, 20):.1f}", "axis": random.choice(["X", "Y", "UP"])}
    names = _names(arm) | figures
    sentence = str(random.choice((MOTIONS if what == "pause" else BY_HAND)[start]))
    return Drawn(
        what=what,
        start=start,
        arm=arm,
        sentence=sentence.format(**names),
        later=str(random.choice(LATER)).format(**names),
        then=str(random.choice(PAUSED_THEN if what == "pause" else LEAVES)),
        after_s=float(random.uniform(0.1, 3.0 if what == "pause" else 0.8)),  # a tick by hand takes milliseconds
        twist=[*random.uniform(-0.1, 0.1, 3).tolist(), *random.uniform(-0.3, 0.3, 3).tolist()],
    )


def run(n: int) -> Ran:
    """The run of this number: sentences are drawn until one is paused, or handed to the operator."""
    random = np.random.default_rng([SEED, n])
    for _ in range(ATTEMPTS):
        found = leave_alone(draw(random, "pause" if n % 2 else "operator"))
        if found is not None:
            return found
    raise AssertionError(f"run {n}: {ATTEMPTS} sentences ended before they were left alone")


class Person:
    """Says sentences to a cluster that others have left, and does what is done of those that wait."""

    def __init__(self, cluster: OneProcess) -> None:
        self.cluster = cluster
        self.given: list[str] = []
        self.waits = False  # the last sentence has no end, and what it waits for names no sentence that ends that
        self.moved = False  # an arm has moved by a sentence that succeeded
        self.story: list[str] = []

    def say(self, sentence: str) -> Answer:
        self.given.append(sentence)
        cluster = self.cluster
        command = cluster.give(sentence, client="bob")
        done: set[str] = set()
        self.waits = False
        while not _settled(cluster, command):
            waits = next((n for n in reversed(cluster.notes) if n.command == command), None)
            step = waits.clears[0] if waits is not None and waits.clears else ""
            if not step or step in done:
                self.waits = True
                return Answer(False, f"waits: {in_words(waits) if waits is not None else ''}")
            done.add(step)
            self.given.append(step)
            answer = cluster.give(step, client="bob")
            if not _settled(cluster, answer):
                return Answer(False, f"{step} has no end")
            self.story.append(f"{step}: {Answer.of_outcome(cluster.outcomes[answer])}")
        outcome = cluster.outcomes[command]
        if outcome.kind is OutcomeKind.SUCCEEDED and advice.is_own(sentence):
            self.moved = True
        return Answer.of_outcome(outcome)

    def truth(self) -> dict[str, Any]:
        found: dict[str, Any] = self.cluster.sim.truth()
        return found


def _settled(cluster: OneProcess, command: str) -> bool:
    """Let time pass until the command has ended; False if it waits, and nothing moves."""
    last, still, here = cluster.ticks + LIMIT, 0, list[Any]()
    while command not in cluster.outcomes and cluster.ticks < last and still < WAITS:
        cluster.tick()
        before, here = here, [executor.sample.joints for executor in cluster.mcm.executors.values()]
        still = still + 1 if here == before else 0
    return command in cluster.outcomes


def leave_alone(drawn: Drawn) -> Ran | None:
    """None: the sentence has ended before."""
    cluster = _at(drawn.start, drawn.arm)
    command = cluster.give(drawn.sentence)
    left = _pause(cluster, command, drawn) if drawn.what == "pause" else _operate(cluster, command, drawn)
    if not left:
        return None
    cluster.ticks += HOUR
    person = Person(cluster)
    aim = drawn.later
    if drawn.then in ("RESUME", "ABORT"):
        cluster.give(f"{drawn.then} {command}", client="bob")
        aim = drawn.sentence
    if drawn.then == "HALT":
        cluster.halt()
    if drawn.then in ("RESUME", "ABORT", "HALT") and not _settled(cluster, command):
        return Ran(drawn, "stuck", f"{drawn.then} does not end {command}", 0, [])
    if drawn.then == "RESUME" and cluster.outcomes[command].kind is OutcomeKind.SUCCEEDED:
        return Ran(drawn, "done", "", 0, [])
    ended = cluster.outcomes.get(command)
    first = Answer.of_outcome(ended) if ended is not None and aim == drawn.sentence else person.say(aim)
    if not first.succeeded and not first.clears and ended is not None:  # nothing holds the arm
        first = person.say(aim)
    if person.waits:
        return Ran(drawn, "stuck", first.message, len(person.given), person.story)
    if first.succeeded:
        return Ran(drawn, "done" if len(person.given) <= advice.MAX_SENTENCES else "stuck", "", 1, person.story)
    followed = advice.follow(person.say, aim, first, person.truth)
    story = [*person.story, *followed.history]
    reached = followed.end == "reached" and len(person.given) <= advice.MAX_SENTENCES
    if reached or (person.moved and followed.end != "same advice"):
        return Ran(drawn, "done" if reached else "free", "", len(person.given), story)
    return Ran(drawn, "stuck", followed.end, len(person.given), story)


def _pause(cluster: OneProcess, command: str, drawn: Drawn) -> bool:
    """Pause the command in its motion. False: it has ended before."""
    moved = 0
    while moved * TICK_S < drawn.after_s:
        cluster.tick()
        moved += any(executor.moving for executor in cluster.mcm.executors.values())
        if command in cluster.outcomes:
            return False
    cluster.give(f"PAUSE {command}", client="bob")
    for _ in range(round(20.0 / TICK_S)):
        cluster.tick()
    return command not in cluster.outcomes


def _operate(cluster: OneProcess, command: str, drawn: Drawn) -> bool:
    """The operator has the arm, moves it and leaves. False: it was not handed over."""
    executor = cluster.mcm.executors[drawn.arm]
    for _ in range(LIMIT):
        if executor.operated is not None or command in cluster.outcomes:
            break
        cluster.tick()
    if executor.operated is None:
        return False
    _drive(cluster, drawn, drawn.after_s, hold=True)
    if drawn.then == "lets go":
        _drive(cluster, drawn, 0.5, hold=False)
    if drawn.then == "the MCM dies":
        cluster.kill_mcm()
    for _ in range(IDLE):
        cluster.tick()  # the deadman
    ends = {"taken": f"TAKE {drawn.arm} FROM OPERATOR", "CANNOT": 'CANNOT "no time"'}
    if drawn.then == "halted":
        cluster.halt()
    elif drawn.then in ends:
        cluster.give(ends[drawn.then], client="bob")
    for _ in range(IDLE):
        cluster.tick()
    return True


def _drive(cluster: OneProcess, drawn: Drawn, for_s: float, *, hold: bool) -> None:
    executor = cluster.mcm.executors[drawn.arm]
    for n in range(round(for_s / TICK_S)):
        if n % PERIOD == 0:
            given = {"primitive": executor.primitive_id, "operator": "ADA", "seen_at_s": cluster.now_s, "hold": hold}
            cluster.mcm.operate(m.Operate(**given, twist=drawn.twist), b"ada", cluster.now_s)
        cluster.tick()


def main() -> None:
    given = numbered_runs.arguments(__doc__).parse_args()
    question("left_alone", "does a sentence lead on after a pause of an hour, or an operator who left?", seed=SEED)
    found: list[Ran] = []
    for n in given.only or range(given.runs):
        one = run(n)
        found.append(one)
        print(f"  run {n}: {one.drawn}: {one.end}, {one.given} sentences {one.why}", flush=True)
        if one.end == "stuck" or given.only:
            print("\n".join(f"      {line}" for line in one.story), flush=True)
    led = sum(one.end != "stuck" for one in found)
    low, high = wilson(led, len(found))
    rows = [
        ("left alone", f"{len(found)}: {dict(Counter(f'{one.drawn.what}, {one.drawn.then}' for one in found))}"),
        ("led on within four sentences", f"{led} (Wilson {100 * low:.1f} to {100 * high:.1f} %)"),
        ("stuck", f"{dict(Counter(one.why for one in found if one.end == 'stuck'))}"),
    ]
    metrics: dict[str, float | None] = {"runs": len(found), "led_on": led, "low": low, "high": high}
    numbered_runs.report("left_alone", metrics, rows, kept=given.runs >= FEWEST and not given.only)


if __name__ == "__main__":
    main()

"""Of the refusals of a TEST: how often does the first repair that it offers succeed when it is executed?

    python -m benchmarks.repairs [--refusals 60] [--seed 1]

A cell is brought into a state by up to three random sentences on exact arms. Random sentences are tested until one is
refused for a reason that a repair may avoid: a hand that holds something or nothing, an arm in the way, a closed door,
tight bolts, a full seat, a place out of reach, a misspelt name, a doubtful fact. Then the sentences of the first repair
are executed. Each must succeed. A refusal without a repair counts in `offered_percent` only. Sentences that need a
compliant arm (INSERT, LOOSEN, OPEN of a door) are left out, because exact arms do not comply.
"""

from __future__ import annotations

import argparse
import random
import time
from collections import Counter
from typing import NamedTuple

from benchmarks.report import finish, question
from rtc.model.cells.cell import Cell
from rtc.protocol.messages import RehearsalInput, Validity, WorldChange
from rtc.protocol.outcomes import Refusal
from rtc.protocol.rehearsal import Repair
from tests.workers.conftest import Bench, Kinematic, record
from tests.workers.rehearsal.on_paper import PROGRAMS
from workers.planning.robot_models import CellModel
from workers.rehearsal import rehearse
from workers.rehearsal.repairs import REPAIRABLE

ARMS, HANDS = ("RIGHT-ARM", "LEFT-ARM"), {"RIGHT-ARM": "RIGHT-END-EFF", "LEFT-ARM": "LEFT-END-EFF"}
DRAWS = 30  # sentences that are tried in one state until one is refused
DOUBTED = 0.15  # share of states in which one fact is doubtful
MISSPELT = 0.1  # share of sentences with a misspelt name
FORMS = (
    "GRASP {hand} {module} {handle}",
    "GRASP {module} WITH {arm}",
    "LIFT {module} BY 10 CM WITH {arm}",
    "PLACE {module} ON {rack} WITH {arm}",
    "MOVE {arm} TO {front}",
    "MOVE {arm} BY 15 CM ALONG {axis}",
    "RELEASE {module} WITH {arm}",
    "STOW {arm}",
    "APPROACH {module} {handle} WITH {arm}",
    "VERIFY {module} AT {arm}",
)
OF_SERVICING = (
    "GRASP {hand} DOOR-2 LATCH-PULL",
    "RELEASE DOOR-2 WITH {arm}",
    "EXTRACT MACS-OLD FROM BAY-2 WITH {arm}",
    "GRASP {hand} POWER-DRIVER TOOL-GRIP",
    "APPROACH BOLT-1 WITH {arm}",
)


class Case(NamedTuple):
    """One refusal, and what became of its first repair."""

    sentence: str
    refusal: Refusal
    first: Repair | None
    why_not: str  # empty: the first repair has succeeded, or there is none


class Draw:
    """Random sentences and states of one cell."""

    def __init__(self, model: CellModel, seed: str) -> None:
        self.model, self.random = model, random.Random(seed)
        self.servicing = any(thing.name == "DOOR-2" for thing in model.cell.objects)

    def sentence(self) -> str:
        one = self.random.choice
        arm = one(ARMS)
        form = one((*FORMS, *OF_SERVICING)) if self.servicing else one(FORMS)
        text = form.format(
            arm=arm,
            hand=HANDS[arm],
            module=one(("MACS-NEW", "MACS-OLD")),
            handle=one(("HANDLE-A", "HANDLE-B")),
            rack=one(("RACK-1", "RACK-2")),
            front=one([place.name for place in self.model.cell.places]),
            axis=one(("UP", "LEFT", "RIGHT", "FORWARD", "BACK")),
        )
        return self._misspelt(text) if self.random.random() < MISSPELT else text

    def _misspelt(self, text: str) -> str:
        words = text.split()
        names = [n for n, word in enumerate(words) if "-" in word and word not in (*ARMS, *HANDS.values(), "WITH")]
        if names:
            n = self.random.choice(names)
            words[n] = words[n][0] + words[n][2] + words[n][1] + words[n][3:]  # two letters in the wrong order
        return " ".join(words)


def tested(bench: Bench, sentence: str) -> tuple[Refusal | None, list[Repair]]:
    data = RehearsalInput(command="C-99", text=f"TEST {sentence}", parsed=record(f"TEST {sentence}"), at_s=bench.now_s)
    found = rehearse.run(PROGRAMS, bench.model, bench.world, data)
    if isinstance(found, Refusal):
        return found, []
    return found.refusal, found.rehearsal.repairs


def prepared(draw: Draw) -> Bench:
    """A bench after up to three sentences that succeed; sometimes one fact is doubtful."""
    bench = Bench(Kinematic(draw.model.cell), draw.model)
    for _ in range(draw.random.randrange(4)):
        for _ in range(DRAWS):
            sentence = draw.sentence()
            if tested(bench, sentence)[0] is None:
                bench.do(sentence)
                break
    if draw.random.random() < DOUBTED:
        key = draw.random.choice(["MACS-NEW.frame", "MACS-OLD.frame", "RIGHT-ARM.joints"])
        doubt = WorldChange(key=key, keep_value=True, validity=draw.random.choice([Validity.SUSPECT, Validity.UNKNOWN]))
        bench.world = bench.world.overlay([doubt])
    return bench


def case(draw: Draw) -> Case | None:
    bench = prepared(draw)
    for _ in range(DRAWS):
        sentence = draw.sentence()
        refusal, offered = tested(bench, sentence)
        if refusal is None or refusal.reason not in REPAIRABLE:
            continue
        if not offered:
            return Case(sentence, refusal, None, "")
        return Case(sentence, refusal, offered[0], _executed(bench, offered[0]))
    return None


def _executed(bench: Bench, repair: Repair) -> str:
    """Why the repair has not succeeded; empty if it has."""
    for sentence in repair.sentences:
        run = bench.do(sentence)
        if not run.succeeded:
            why = run.failure or run.refusal
            return f"{sentence}: {why.message if why else 'a step has failed'}"
    return ""


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--refusals", type=int, default=60)
    options.add_argument("--seed", type=int, default=1)
    chosen = options.parse_args()
    question("repairs", "How often does the first repair that a refused TEST offers succeed?", seed=chosen.seed)
    models = [CellModel(Cell.load(name)) for name in ("swapout", "servicing")]
    cases: list[Case] = []
    began_s, n = time.process_time(), 0
    while len(cases) < chosen.refusals:
        found = case(Draw(models[n % 2], f"{chosen.seed}/{n}"))
        n += 1
        if found is not None:
            cases.append(found)
            end = "no repair" if found.first is None else found.why_not or "succeeded"
            then = "; ".join(found.first.sentences) if found.first else ""
            print(f"  {found.sentence}  [{found.refusal.message}]  ->  {then}: {end}", flush=True)
    offered = [one for one in cases if one.first is not None]
    done = [one for one in offered if not one.why_not]
    reasons = Counter(one.refusal.reason.value for one in cases)
    finish(
        "repairs",
        {
            "refusals": len(cases),
            "offered_percent": 100.0 * len(offered) / len(cases),
            "first_succeeds_percent": 100.0 * len(done) / len(offered) if offered else None,
            "processor_s": time.process_time() - began_s,
            **{f"of_{reason}": count for reason, count in sorted(reasons.items())},
        },
        data=[[one.sentence, one.refusal.message, one.first and one.first.sentences, one.why_not] for one in cases],
    )


if __name__ == "__main__":
    main()

"""Runs of the verbs under variants: the scenes and errors of `benchmarks.skills`, and what the thresholds met."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks import skills
from benchmarks.margins.met import Met, Watched
from benchmarks.margins.variants import VARIANTS
from benchmarks.skills import AT_DOOR, DRIVER, LOOSENED, SCENES, SkillRun
from tests.workers.conftest import Run

SCENES_OF_MARGINS = SCENES | {
    "GRASP DOOR": skills.of_door([], AT_DOOR[0]),
    "GRASP DRIVER": skills.of_bolt([], DRIVER[0]),
    "PLACE DRIVER": skills.of_bolt(DRIVER, "PLACE POWER-DRIVER ON TOOL-RACK WITH RIGHT-ARM"),
    "TURN": skills.of_bolt(LOOSENED, "TURN BOLT-1 BY 2 TURNS WITH RIGHT-ARM"),
}


class MarginRun(NamedTuple):
    """One sentence under one variant, and what its thresholds met."""

    sentence: str
    variant: str
    number: int  # of the start
    succeeded: bool
    cause: str
    met: list[Met]

    @property
    def key(self) -> tuple[str, str, int]:
        return self.sentence, self.variant, self.number

    def in_words(self) -> str:
        return f"{self.variant}, start {self.number}: {self.sentence}: {self.cause or 'succeeded'}"


class MarginTrial(skills.Trial):
    """As in `benchmarks.skills`, with thresholds that are watched; each sentence is kept in a file at once."""

    physical = Watched
    scenes = SCENES_OF_MARGINS
    subsystem: Watched
    variant = ""
    out: Path | None = None

    def under(self, variant: str, verbs: Sequence[str], number: int, out: Path | None) -> None:
        """The runs of this number of verbs whose scenes begin here. This process can make no other run after it."""
        self.run, self.variant, self.out = SkillRun("", number, skills.offset(number)), variant, out
        self._vary()
        self._displace()
        self._branch(verbs, 0)

    def _vary(self) -> None:
        VARIANTS[self.variant](self.subsystem)

    def _repaired(self, sentence: str, done: Run) -> bool:
        return False  # what follows a failure is the question of `benchmarks.skills`

    def _done(self, sentence: str) -> bool:
        self.subsystem.met.clear()
        succeeded = super()._done(sentence)
        cause = "" if succeeded else self.run.cause
        made = MarginRun(sentence, self.variant, self.run.number, succeeded, cause, self.subsystem.met)
        print(made.in_words(), flush=True)
        if self.out is not None:
            with self.out.open("a") as file:
                file.write(json.dumps(made) + "\n")
        return succeeded


def prepare(verbs: Sequence[str], kind: type[MarginTrial] = MarginTrial) -> list[tuple[MarginTrial, list[str]]]:
    """One trial for each common beginning, with its verbs; runs continue in copies."""
    roots: dict[tuple[str, str, bool], list[str]] = {}
    for verb in verbs:
        roots.setdefault(SCENES_OF_MARGINS[verb].root, []).append(verb)
    return [(kind(SCENES_OF_MARGINS[ones[0]], cameras=True), ones) for ones in roots.values()]


def joined(files: Iterable[Path]) -> list[MarginRun]:
    """The runs of several files; of the same sentence, variant and start the last one."""
    rows = [json.loads(line) for file in files if file.exists() for line in file.read_text().splitlines()]
    made = [
        MarginRun(sentence, variant, number, succeeded, cause, [Met(*one) for one in met])
        for sentence, variant, number, succeeded, cause, met in rows
    ]
    return list({run.key: run for run in made}.values())

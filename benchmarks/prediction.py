"""How long do the motions of the demos take, and how long were they predicted to take?

    python -m benchmarks.prediction

The sentences of `rtc demo grasp`, and those for a door and the module behind it, in physics, in one process, one after
the other, with cameras that see exactly. Each step of an arm or a hand is compared by the analyzer; here the figures
are collected. A motion that ends at a touch ends where the body is: its time is known only within the band that belongs
to the search.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from benchmarks.report import finish, question
from rtc.apps.demos import grasp
from rtc.model.cells.cell import Cell
from rtc.protocol.messages import EvaluationContext
from rtc.protocol.outcomes import Figure, OutcomeKind, StopReason
from sim_mcm.arms.bullet_arm import BulletCell
from tests.workers.eyes import Ideal
from tests.workers.one_process import OneProcess
from workers.planning.robot_models import CellModel

LIMIT_S = 300.0  # of simulated time, for one sentence
SHORT_S = 0.2  # a step of a hand that is there already, or a tug: milliseconds are a large part of it
SENTENCES = {
    "swapout": [*grasp.GRASPS, *grasp.LIFTS, grasp.MOVE, grasp.VERIFY, *grasp.PLACES, *grasp.STOWS],
    "unbolted": [
        "GRASP LEFT-END-EFF DOOR-2 LATCH-PULL",
        "OPEN DOOR-2 BY 90 DEG WITH LEFT-ARM",
        "RELEASE DOOR-2",
        "GRASP RIGHT-END-EFF MACS-OLD HANDLE-A",
        "LIFT MACS-OLD BY 25 CM WITH RIGHT-ARM",
        "INSERT MACS-OLD INTO BAY-2 WITH RIGHT-ARM",
        "STOW RIGHT-ARM",
        "GRASP LEFT-END-EFF DOOR-2 LATCH-PULL",
        "CLOSE DOOR-2",
        "RELEASE DOOR-2",
        "STOW LEFT-ARM",
    ],
}


class Step(NamedTuple):
    label: str
    kind: str
    duration: Figure
    touches: bool
    moves: bool  # an arm, along a path

    @property
    def off(self) -> float:
        """Measured against predicted, as a share."""
        return self.duration.measured / self.duration.predicted - 1.0


def measured(cell_name: str, sentences: list[str]) -> list[Step]:
    """The steps of these sentences. Raises AssertionError if one does not succeed."""
    cell = Cell.load(cell_name)
    process = OneProcess(BulletCell(cell), CellModel(cell), eyes=Ideal(cell))
    evaluations: list[EvaluationContext] = []
    found: list[Step] = []
    for sentence in sentences:
        command = process.give(sentence)
        while command not in process.outcomes:
            live = process.state.commands.get(command)
            if live is not None and live.evaluation != msgspec.Raw(b"\xc0"):
                evaluations[:] = [msgspec.msgpack.decode(live.evaluation, type=EvaluationContext)]
            before = len(process.notes)
            process.tick()
            found += [step for note in process.notes[before:] if (step := _step(note, evaluations)) is not None]
        assert process.outcomes[command].kind is OutcomeKind.SUCCEEDED, process.outcomes[command]
        print(f"  {sentence}", flush=True)
    return found


def _step(note: Any, evaluations: list[EvaluationContext]) -> Step | None:
    figures = note.compared.figures if note.compared is not None else []
    duration = next((figure for figure in figures if figure.name == "duration_s"), None)
    if duration is None:
        return None
    step = evaluations[0].step
    kind = f"{note.compared.verb} {note.compared.kind}"
    return Step(step.label, kind, duration, StopReason.CONTACT in step.expect, bool(step.space))


def main() -> None:
    question("prediction", "How long do the motions of the demos take, against their prediction?")
    steps = [step for cell, sentences in SENTENCES.items() for step in measured(cell, sentences)]
    known = [step for step in steps if step.moves and not step.touches]
    hands = [step for step in steps if not step.moves and step.duration.predicted > SHORT_S]
    rows = [
        (
            f"{step.kind}: {step.label}",
            f"{step.duration.predicted:.3f} s, {step.duration.measured:.3f} s, {step.off:+.1%}",
        )
        for step in steps
    ]
    finish(
        "prediction",
        {
            "steps": len(steps),
            "motions": len(known),
            "motions_worst_percent": 100.0 * max(abs(step.off) for step in known),
            "hands_worst_percent": 100.0 * max(abs(step.off) for step in hands),
            "touches": sum(step.touches for step in steps),
            "outside": sum(step.duration.drifts for step in steps),
        },
        rows=rows,
    )


if __name__ == "__main__":
    main()

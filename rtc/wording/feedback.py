"""The feedback loop of the paper's Figure 3 in the notes of a command: monitor, predictor, evaluator, trimmer (R79).

The monitor is the subsystem that reports. The other three are parts of the analyzer: it compares the report with the
prediction of the binder, judges it, and may choose a trim.
"""

from __future__ import annotations

import math

from rtc.protocol.messages import NoteKind, ProgressNote
from rtc.protocol.outcomes import Compared, Figure
from rtc.wording import notes

MONITOR, PREDICTOR, EVALUATOR, TRIMMER = "monitor", "predictor", "evaluator", "trimmer"


def stages(note: ProgressNote) -> list[tuple[str, str]]:
    """The stages whose work the note tells of, with their results in words; empty for a note of the forward loop."""
    kind, at, _ = note.node.partition("@")
    if kind and not at:
        return [(MONITOR, notes.in_words(note))]
    if kind != "analyzer":
        return []
    found = [(PREDICTOR, in_words(note.compared))] if note.compared is not None else []
    if note.kind is NoteKind.TRIM:
        return [*found, (EVALUATOR, notes.judged(note)), (TRIMMER, notes.trim(note))]
    return [*found, (EVALUATOR, notes.in_words(note))]


def in_words(compared: Compared) -> str:
    """Each figure as measured, with what was predicted: "duration 6.20 s (6.18 +- 0.31)"."""
    return ", ".join(map(figure_in_words, compared.figures)) or "it ended otherwise than predicted"


def figure_in_words(figure: Figure) -> str:
    name, scale, unit = shown_as(figure.name)
    band = f"{scale * figure.predicted:.4g} +- {scale * figure.band:.3g}"
    return f"{name} {scale * figure.measured:.4g} {unit} ({band})" + (" DRIFTS" if figure.drifts else "")


def shown_as(figure: str) -> tuple[str, float, str]:
    """The name of a figure for people, and the factor to the unit in which it is shown: off goal, 1000, mm."""
    name, _, unit = figure.rpartition("_")
    factor, shown = UNITS.get(unit, (1.0, unit))
    return name.replace("_", " "), factor, shown


UNITS: dict[str, tuple[float, str]] = {"m": (1e3, "mm"), "rad": (180.0 / math.pi, "deg"), "n": (1.0, "N")}

"""The words of notes, which people know from the trace."""

from __future__ import annotations

from typing import Any

import pytest

from rtc.protocol.messages import NoteKind, Phase, ProgressNote
from rtc.protocol.outcomes import OutcomeKind, StopReason
from rtc.wording.notes import MADE, TEXTS, in_words

K = NoteKind
TRIMMED = {"message": "lift A", "trim": 2, "pieces": ["regrasp A", "lift A again"]}
WORDS: list[tuple[NoteKind, dict[str, Any], str]] = [
    (K.PHASE, {}, ""),
    (K.IN_USE, {"about": "A-ARM", "owner": "C-1"}, "A-ARM is in use by C-1"),
    (
        K.IN_USE_PAUSED,
        {"about": "A-ARM", "owner": "C-1", "clears": ["RESUME C-1", "ABORT C-1"]},
        "A-ARM is in use by C-1, which is paused: RESUME C-1, or ABORT C-1",
    ),
    (
        K.IN_USE_OPERATOR,
        {"about": "SEAT", "owner": "C-1", "arm": "A-ARM", "clears": ["TAKE A-ARM FROM OPERATOR"]},
        "SEAT is in use by C-1: the operator has A-ARM; TAKE A-ARM FROM OPERATOR ends that",
    ),
    (
        K.SURRENDERED,
        {"owner": "C-1", "clears": ["RESUME C-2"]},
        "waits for the operator, who is asked to do what C-1 has failed to do; RESUME C-2 goes on",
    ),
    (
        K.BREAKPOINT,
        {"about": "GRASP:5", "clears": ["RESUME C-2"]},
        "breakpoint GRASP:5; `rtc step C-2`, or RESUME C-2",
    ),
    (K.ASSIGNED, {}, "nothing to execute"),
    (K.STEP_ENDED, {"reason": StopReason.GOAL}, "ended: goal"),
    (K.STEP_ENDED, {"reason": StopReason.BLOCKED, "message": "{0}"}, "ended: blocked ({0})"),
    (K.JUDGED, {"reason": StopReason.GOAL}, "goal: as expected"),
    (K.JUDGED, {"message": "lift A", "found": "2 mm off", "drift": "took 3 s"}, "lift A; 2 mm off; took 3 s"),
    (K.TRIM, TRIMMED, "lift A: trim 2, regrasp A; then lift A again"),
    (K.TRIM, {"reason": StopReason.SLIP, "trim": 1, "pieces": ["x"], "drift": "y"}, "slip: trim 1, x; y"),
    (K.STANDS, {"value": 0.4}, "stands on its path, 40% done"),
    (K.CONDITION, {"message": "FORCE EXCEEDS 5 N", "value": 6.0, "unit": "N"}, "FORCE EXCEEDS 5 N: 6 N"),
    (K.CONDITION, {"message": "CONTACT"}, "CONTACT"),
    (K.WORKER_LOST, {"about": "binder@2", "message": "gone"}, "binder@2 lost (gone); job again"),
    (K.AT_REST, {}, "at rest: it had not begun"),
    (K.OUTCOME, {"outcome": OutcomeKind.FAILED, "message": "jammed"}, "failed: jammed"),
]


@pytest.mark.parametrize(("kind", "facts", "words"), WORDS)
def test_a_note_in_words(kind: NoteKind, facts: dict[str, Any], words: str) -> None:
    assert in_words(ProgressNote(seq=1, at_s=0.0, command="C-2", phase=Phase.HELD, kind=kind, **facts)) == words


def test_every_kind_of_note_has_its_words_in_one_of_two_tables() -> None:
    assert sorted([*TEXTS, *MADE]) == sorted(NoteKind)

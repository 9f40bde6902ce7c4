"""What is advised in capitals can be typed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import msgspec
import pytest

from rtc.model.cells.cell import Cell
from rtc.programs import loader
from rtc.protocol.advice import ANOTHER_ARM, NOTHING, Advice, fill_in
from rtc.protocol.outcomes import Refusal
from tests.workers.advised_sentences import unparsed, wrong
from tests.workers.conftest import Bench, Reporter
from workers.planning.robot_models import CellModel

FILLED = {
    **dict.fromkeys(("arm", "other", "hand", "holder"), "RIGHT-ARM"),
    **dict.fromkeys(("object", "held", "location", "carrier"), "MACS-NEW"),
    **dict.fromkeys(("target", "seat", "free"), "RACK-1"),
    **dict.fromkeys(("body", "before"), "DOOR-2"),
    **{
        "bolt": "BOLT-1",
        "plug": "PLUG-1",
        "socket": "SOCKET-1",
        "place": "CLEAR-POINT-1",
        "camera": "RAIL-CAMERA",
        "point": "HANDLE-A",
    },
    **{"angle": "30", "back": "5", "position": "1 2 3", "attitude": "0 0 0", "at": "30 DEG"},
    **{"free_cm": "15", "far": "99"},
    **{"away": "5 CM ALONG X", "turn": "CLOSE DOOR-2", "lift": "LIFT MACS-NEW BY 5 CM", "leave": "RETRACT RIGHT-ARM"},
    **{"let_go": "RELEASE MACS-NEW", "sentence": "STOW RIGHT-ARM", "cameras": "RAIL-CAMERA", "attribute": "MASS"},
    **{
        "example": "2 KG",
        "or_mass": "",
        "closer": "STOW RIGHT-ARM MAINTAIN AVOID-NEIGHBORS BY 3 MM",
        "out_first": "RELEASE MACS-NEW WITH LEFT-ARM",
        "found_at": "VERIFY MACS-NEW AT RIGHT-ARM",
        "free_cm": "15",
        "far": "99",
        "grip": "20",
    },
}
ADVICE = ("clears", "again", "pressing", "needs", "not_settable")


def rows(document: Any, place: str = "") -> Iterator[tuple[str, Advice]]:
    """The rows of the advice of a program, with their place."""
    for key, value in document.items() if isinstance(document, dict) else ():
        where = f"{place}.{key}"
        if isinstance(value, list) and value and any(name in where.split(".") for name in ADVICE):
            with suppress(msgspec.ValidationError):  # the preconditions of a script are names
                yield where, msgspec.convert(value, Advice)
        yield from rows(value, where)


@pytest.mark.parametrize("kind", ["elaborator", "binder", "analyzer"])
def test_each_row_of_advice_is_made_of_sentences(kind: str) -> None:
    found = list(rows(msgspec.json.decode(loader.default(kind))))
    assert len(found) > 10
    bad = {}
    for place, advice in found:
        arm = {"before": "RIGHT-ARM"} if "arm_before" in place else {}
        filled = fill_in(advice, {**FILLED, "another_arm": [ANOTHER_ARM], "target_cure": [NOTHING], **arm})
        if phrases := wrong(filled):
            bad[place] = phrases
    assert not bad


REFUSED = (
    *("LIFT MACS-OLD BY 10 CM WITH RIGHT-ARM", "GRASP MACS-NEW WITH RIGHT-ARM", "APPROACH MACS-NEW WITH LEFT-ARM"),
    *("PLACE MACS-NEW ON RACK-2 WITH RIGHT-ARM", "INSERT MACS-NEW INTO BAY-2", "EXTRACT MACS-NEW FROM BAY-2"),
    *("MOVE RIGHT-ARM BY 90 CM ALONG X", "MOVE RIGHT-ARM TO RACK-2-FRONT", "STOW RIGHT-ARM", "OPEN RIGHT-ARM"),
    *("CLOSE RIGHT-ARM BY 900 MM", "VERIFY MACS-NEW AT LEFT-ARM", "RELEASE MACS-NEW", "VERIFY BOLT-1 AT LOOSE"),
    *("LOOSEN BOLT-1", "LOOSEN BOLT-2 BY 99 TURNS", "OPEN DOOR-2 BY 400 DEG", "CLOSE DOOR-2", "OPEN DOOR-2 TO 0 DEG"),
    *("LOCATE BOLT-1", "TRACK BOLT-1 FOR 1 SEC", "PLACE POWER-DRIVER ON RACK-2 WITH RIGHT-ARM"),
    "MOVE RIGHT-ARM BY 5 CM ALONG X UNLESS TURN EXCEEDS 200 DEG THEN STOP",
)


@pytest.mark.parametrize("held", ["", "GRASP POWER-DRIVER WITH RIGHT-ARM", "GRASP DOOR-2 LATCH-PULL WITH LEFT-ARM"])
def test_what_refused_sentences_are_advised_can_be_typed(held: str) -> None:
    """UNTIL TORQUE EXCEEDS less than 5 NM was advised, and MOVE BOTH-ARMS BY a distance."""
    model = CellModel(Cell.load("servicing"))
    bench = Bench(Reporter(model.cell), model)
    assert not held or bench.do(held).succeeded
    made = {sentence: bench.elaborate(sentence) for sentence in REFUSED}
    advice = {sentence: one.clears for sentence, one in made.items() if isinstance(one, Refusal)}
    assert len(advice) > len(REFUSED) // 2
    assert not {sentence: wrong(one) for sentence, one in advice.items() if wrong(one)}


@pytest.mark.parametrize(
    ("advice", "found"),
    [
        ("UNTIL TORQUE EXCEEDS less than 5 NM", ["UNTIL TORQUE EXCEEDS"]),
        ("OPEN DOOR-2 BY the angle at which it should stop", ["OPEN DOOR-2 BY"]),
        ("a value below 5 NM: UNTIL TORQUE EXCEEDS 4 NM", []),
        ("LOCATE X, or SET X FRAME x y z CM roll pitch yaw DEG; then do it again", []),
    ],
)
def test_what_is_no_sentence_is_found(advice: str, found: list[str]) -> None:
    assert unparsed(advice) == found

"""Mechanisms of installed packages: which rows are used, their words, and the guard round their functions."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from rtc.apps.cli import doctor
from rtc.model.cells.cell import Cell
from rtc.plugins import registry
from rtc.plugins.guard import PluginError
from rtc.programs import loader
from rtc.programs.schema import ElaboratorProgram
from rtc.protocol.advice import Alternative
from rtc.protocol.messages import Validity, WorldChange
from rtc.protocol.outcomes import ProgramError, RefusalReason, Refused
from tests.plugins.toy_packages import Install
from tests.workers.conftest import CELL
from workers.mechanisms import MECHANISMS, installed_rows
from workers.mechanisms.mechanism import Mechanism
from workers.tasks.anchor import Anchor
from workers.tasks.unmet import UnmetPrecondition

HEAD = "import msgspec\nfrom workers.mechanisms.mechanism import Mechanism\ndef some(*given):\n    return None\n"


def row(fields: str, before: str = "", name: str = "toy") -> str:
    return f"{HEAD}{before}\nMECHANISM = Mechanism(name={name!r}, {fields})\n"


def loaded(install: Install, code: str, name: str = "toy") -> installed_rows.InstalledRows:
    install(registry.MECHANISMS, name, "MECHANISM", code)
    return installed_rows.load(MECHANISMS)


@pytest.mark.parametrize(
    ("fields", "both"),
    [
        ('needs={"hand_empty": some}', ("hand_empty", "grip")),
        ('effects={"turned": some}', ("turned", "bolts")),
        ('stated={"angle": some}', ("angle", "hinges")),
        ('anchors={"port": some}', ("port", "toy.")),
        ('foreseen={"other.port": some}', ("other.port", "toy.")),
        ('violated={"toy.done": some}', ("toy.done", "effects")),
        ('actions={int: some}', ("int", "toy.")),
        ('reads={"toy.step": ["far_m"]}', ("toy.step", "actions")),
        ('actions={"toy.step": some}, reads={"toy.step": "far_m"}', ("list", "text")),
        ("states=some", ("states", "package")),
        ('reports={str: some}', ("reports", "package")),
        ('piece=type("Piece", (msgspec.Struct,), {})', ("Piece", "unknown fields")),
        ("needs=3", ("int", "")),
    ],
)  # fmt: skip
def test_a_row_that_takes_what_is_of_others_is_not_used(install: Install, fields: str, both: tuple[str, str]) -> None:
    """The reason names what it states, and whose that is."""
    rows = loaded(install, row(fields))
    assert rows.used == ()
    assert all(word in rows.failed["toy"] for word in both)


@pytest.mark.parametrize(
    ("code", "name"),
    [
        (row("", name="bolts"), "bolts"),
        (row("", name="another"), "toy"),
        (row("", name="object"), "object"),
        ("MECHANISM = 3", "toy"),
        ("raise SystemExit", "toy"),
    ],
)
def test_a_row_of_another_name_or_kind_is_not_used(install: Install, code: str, name: str) -> None:
    rows = loaded(install, code, name)
    assert (rows.used, list(rows.failed)) == ((), [name])


def test_of_two_packages_with_one_attribute_the_first_is_used(install: Install) -> None:
    install(registry.MECHANISMS, "a", "MECHANISM", row('plausible={"charge": some}', name="a"))
    rows = loaded(install, row('plausible={"charge": some}'))
    assert [each.name for each in rows.used] == ["a"]
    assert "charge" in rows.failed["toy"]


GOOD: Mapping[str, Any] = {
    "needs": UnmetPrecondition("no", "MACS-NEW"),
    "anchors": Anchor(pose=[0.0] * 7),
    "effects": [WorldChange(key="MACS-NEW.charge", value=[1, 2.5, "x"], validity=Validity.SUSPECT)],
    "violated": "loose",
    "found": ("seen", "as believed"),
    "advice": [Alternative(sentences=["STOW"])],
    "stated": {"MACS-NEW.charge": {"at": 3}},
    "points": CELL.object("MACS-NEW").grasp_points,
    "partners": [(CELL.arms[0], None), (CELL.arms[1], CELL.places[0])],
}
ODD: Mapping[str, list[Any]] = {
    "needs": ["no", UnmetPrecondition(3, "MACS-NEW"), ("no", "x", "", "")],  # type: ignore[arg-type]
    "anchors": [None, [0.0] * 7, Anchor(pose="here"), Anchor(pose=[np.ones(3)])],  # type: ignore[arg-type, list-item]
    "effects": [None, 3, "text", [3], [WorldChange(key=3)], [WorldChange(key="A.b", value=object())]],  # type: ignore[arg-type]
    "violated": [None, 3, b"loose"],
    "found": [("seen",), "seen", ("seen", None)],
    "advice": [["STOW", 3], None, [Alternative(sentences=[3])]],  # type: ignore[list-item]
    "stated": [{"MACS-NEW.charge": object()}, {3: 3}, [1]],
}


def guarded(field: str, function: Any) -> Any:
    """The function of this field as the stages get it."""
    is_word = field in (*installed_rows.WORDS, *installed_rows.SHARED)
    made = Mechanism(name="toy", **{field: {"toy.word": function} if is_word else function})
    found = getattr(installed_rows._guarded(made), field)
    return found["toy.word"] if is_word else found


@pytest.mark.parametrize("field", GOOD)
def test_what_a_function_returns_is_passed_on(field: str) -> None:
    assert guarded(field, lambda *_: GOOD[field])(None) == GOOD[field]


@pytest.mark.parametrize(("field", "value"), [(field, value) for field, values in ODD.items() for value in values])
def test_an_odd_value_refuses_with_the_name_of_the_package(field: str, value: Any) -> None:
    with pytest.raises(PluginError) as caught:
        guarded(field, lambda *_: value)(None)
    assert "mechanism toy" in str(caught.value)


@pytest.mark.parametrize("odd", [{"toy.a": math.nan}, {"toy.a": "1"}, {"speed_m_s": 1.0}, {"a.b": 1.0}, 3])
def test_odd_figures_refuse(odd: Any) -> None:
    with pytest.raises(PluginError):
        guarded("figures", lambda _: odd)(None)


class OddText(str):
    def __format__(self, _: str) -> str:
        raise SystemExit


def test_a_text_is_plain_before_it_leaves_the_guard() -> None:
    assert type(guarded("violated", lambda _: OddText("loose"))(None)) is str


def test_numbers_of_numpy_are_numbers() -> None:
    assert guarded("figures", lambda _: {"toy.a": np.float32(0.5), "toy.b": 1})(None) == {"toy.a": 0.5, "toy.b": 1.0}


@pytest.mark.parametrize("error", [SystemExit, KeyError("a"), GeneratorExit, MemoryError])
def test_a_function_that_fails_refuses_with_its_name(error: Any) -> None:
    def fail(*_: Any) -> None:
        raise error

    with pytest.raises(PluginError) as caught:
        guarded("effects", fail)(None, None)
    assert "mechanism toy" in str(caught.value)


def test_a_refusal_of_the_package_is_passed_on() -> None:
    def refuse(*_: Any) -> None:
        raise Refused.because(RefusalReason.STATE, "no", clears="yes")

    with pytest.raises(Refused):
        guarded("anchors", refuse)(None)


def test_an_endless_result_ends() -> None:
    def endless(*_: Any) -> Any:
        while True:
            yield "a"

    with pytest.raises(PluginError):
        guarded("attributes", endless)(None)


# --- words of programs -----------------------------------------------------------------------------------

SCRIPT = """
script: toy
case: 1
uses: [hand]
needs: [toy.ready]
plan: [{name: A, at: toy.port, along: X, by: toy.far_m}]
steps: [{do: move, to: A, stop: move_free, space: move_task, label: go, words: {effect: toy.done}}]
"""
WORDS = 'needs={"toy.ready": some}, anchors={"toy.port": some}, effects={"toy.done": some}'


def merged(text: str) -> ElaboratorProgram:
    program = loader.merge("elaborator", loader.default("elaborator"), "toy.yaml", text.encode())
    return loader.decode(program, ElaboratorProgram)


def test_words_without_their_package_are_refused_and_with_it_accepted(install: Install) -> None:
    with pytest.raises(ProgramError, match="no installed package has a mechanism toy"):
        merged(SCRIPT)
    rows = loaded(install, row(WORDS))
    installed_rows.refuse_missing(merged(SCRIPT), rows)


def test_a_step_may_carry_data_for_a_mechanism(install: Install) -> None:
    text = SCRIPT.replace("label: go", "label: go, x-port: [1, 2]")
    install(registry.MECHANISMS, "toy", "MECHANISM", row(WORDS))
    (script,) = (one for one in merged(text).scripts if one.script == "toy")
    assert script.steps[0].extra == {"x-port": [1, 2]}


@pytest.mark.parametrize("word", ["toy.ready", "toy.port", "toy.done"])
def test_a_worker_refuses_a_word_that_the_package_lacks(install: Install, word: str) -> None:
    """The broker accepts it: it imports no package."""
    rows = loaded(install, row(WORDS))
    with pytest.raises(ProgramError, match=f"{word}x.*{word}"):
        installed_rows.refuse_missing(merged(SCRIPT.replace(word, f"{word}x")), rows)


def test_a_worker_without_the_package_says_why(install: Install) -> None:
    rows = loaded(install, row('needs={"hand_empty": some}'))
    with pytest.raises(ProgramError, match="hand_empty"):
        installed_rows.refuse_missing(merged(SCRIPT), rows)


# --- the piece of the cell file --------------------------------------------------------------------------

PIECE = """
class Piece(msgspec.Struct, forbid_unknown_fields=True):
    far_m: float = 0.1
    ports: list[str] = []
"""


def read(folder: Path, **parts: Any) -> Cell:
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump({"extends": "swapout", **parts}))
    return Cell.load(path)


def test_a_piece_is_read_in_the_form_of_its_package(install: Install, tmp_path: Path) -> None:
    install(registry.MECHANISMS, "toy", "MECHANISM", row("piece=Piece", PIECE))
    cell = read(tmp_path, mechanisms={"toy": {"ports": ["A"]}})
    assert Cell.from_bytes(cell.encode()).mechanisms == {"toy": {"ports": ["A"]}}


@pytest.mark.parametrize(
    ("parts", "named"),
    [
        ({"mechanisms": {"toy": {"port": []}}}, ["mechanisms.toy", "port", "far_m, ports"]),
        ({"mechanisms": {"toy": {"far_m": "1"}}}, ["mechanisms.toy", "far_m"]),
        ({"mechanisms": {"other": {}}}, ["mechanisms.other", "no installed package has it", "leave its piece out"]),
        ({"toy": {}}, ["toy", "`mechanisms`"]),
    ],
)
def test_a_wrong_piece_refuses_the_cell_with_what_clears_it(
    install: Install, tmp_path: Path, parts: dict[str, Any], named: list[str]
) -> None:
    install(registry.MECHANISMS, "toy", "MECHANISM", row("piece=Piece", PIECE))
    with pytest.raises(ProgramError) as caught:
        read(tmp_path, **parts)
    assert [word for word in named if word not in str(caught.value)] == []


def test_a_cell_without_pieces_keeps_its_bytes() -> None:
    assert b"mechanisms" not in CELL.encode()


# --- rtc doctor ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        (row('needs={"hand_empty": some}'), "hand_empty"),
        ("import os\nos._exit(3)\n", "status 3"),
        ("import no_such", "no_such"),
    ],
)
def test_doctor_names_a_mechanism_that_is_not_used(
    install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, reason: str
) -> None:
    install(registry.MECHANISMS, "toy", "MECHANISM", code)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    found = [one for one in doctor.installation() if one.about == registry.MECHANISMS]
    assert [bool(one.mend) for one in found] == [True]
    assert "toy" in found[0].found
    assert reason in found[0].found


def test_stages_of_a_process_have_the_words_of_its_packages(install: Install, tmp_path: Path) -> None:
    """In a process of its own: the tables of the stages are made once."""
    install(registry.MECHANISMS, "toy", "MECHANISM", row(WORDS))
    code = "from workers.elaborator.script_checks import NEEDS; from workers.analyzer.analyze import EFFECTS; "
    code += "print([*NEEDS][-1], [*EFFECTS][-1])"
    env = {"PYTHONPATH": f"{tmp_path}:{Path(__file__).parents[2]}"}
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    assert ran.stdout.split() == ["toy.ready", "toy.done"], ran.stderr

"""The language on the command line: what is printed, and the exit status."""

import json

import pytest
import typer
from typer.testing import CliRunner

from broker.decisions.command.operator_answers import ANSWERS
from rtc.apps.cli import language
from rtc.language import dictionary
from rtc.runtime.settings import Settings

APP = typer.Typer()
for command in (language.parse, language.dictionary, language.grammar):
    APP.command()(command)


@pytest.fixture(autouse=True)
def no_cluster(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("RTC_RUN_DIR", str(tmp_path / "run"))


def run(*arguments: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(APP, list(arguments))
    return result.exit_code, result.stdout, result.stderr


def test_parse_tells_how_the_sentence_is_understood() -> None:
    assert run("parse", "grasp Macs_old with Right_arm maintain speed 10 cm/s unless slip then stop.") == (
        0,
        "GRASP (task)\n"
        "  hand           RIGHT-ARM\n"
        "  object         MACS-OLD\n"
        "  constraints    slot SPEED, value 0.1 m/s\n"
        "  reflexes       condition event SLIP, action stop\n",
        "",
    )


def test_parse_explains_what_an_item_means_without_its_argument(tmp_path) -> None:
    s1 = "STOW LEFT-ARM MAINTAIN SAFE-WORK-RANGE AVOID-NEIGHBORS BY 3 CM SPEED SHARED WRIST"
    status, out, _ = run("parse", s1, "--explain")
    assert status == 0
    lines = [line for line in out.splitlines() if line.startswith("  MAINTAIN")]
    assert lines == [
        "  MAINTAIN AVOID-NEIGHBORS: 30 mm, as given; it acts on motions of the arm",
        "  MAINTAIN SAFE-WORK-RANGE: CELL-RANGE, the meaning in cell swapout; it acts on motions of the arm",
        "  MAINTAIN SHARED: WRIST, as given; it acts on motions by the operator",
        "  MAINTAIN SPEED: 10 cm/s, the meaning in cell swapout; it acts on motions of the arm",
    ]


def test_parse_explains_in_the_cell_of_the_cluster(tmp_path) -> None:
    sentence, there = "STOW LEFT-ARM MAINTAIN SPEED", ("--run-dir", str(tmp_path))
    Settings(run_dir=str(tmp_path), cell="servicing").save()
    assert "in cell servicing" in run("parse", sentence, "--explain", *there)[1]
    assert "in cell swapout" in run("parse", sentence, "--explain", *there, "--cell", "swapout")[1]


@pytest.mark.parametrize(
    ("sentence", "words"),
    [
        ("LOCATE MACS-OLD", "the cameras that see MACS-OLD, of CAMERA-1, CAMERA-2, CAMERA-3, CAMERA-4"),
        ("TRACK MACS-OLD", "the camera that sees MACS-OLD best, of CAMERA-1, CAMERA-2, CAMERA-3, CAMERA-4"),
        ("TRACK SATELLITE VIA CAMERA-3", "VIA CAMERA-3: this camera"),
        ("VERIFY MACS-OLD AT RACK-2 VIA CAMERA-9", "refused; the cameras of cell swapout are"),
        ("LOCATE TOOL-RACK", "has no tags"),
    ],
)
def test_parse_explains_which_camera_looks(sentence: str, words: str) -> None:
    cell = "servicing" if "TOOL-RACK" in sentence else "swapout"
    status, out, _ = run("parse", sentence, "--explain", "--cell", cell)
    assert status == 0
    assert words in out.splitlines()[-1]


def test_parse_of_a_sentence_for_an_arm_names_no_camera() -> None:
    assert "CAMERA" not in run("parse", "VERIFY MACS-NEW AT RIGHT-ARM", "--explain")[1]


def test_parse_shows_where_a_sentence_is_wrong() -> None:
    assert run("parse", "MOVE RIGHT-ARM TO") == (
        2,
        "",
        "  MOVE RIGHT-ARM TO\n"
        "                   ^\n"
        "The sentence ends too early, after TO.\n"
        "expected: a name, JOINTS, POSITION\n",
    )


def test_parse_json_is_the_record() -> None:
    status, out, _ = run("parse", "--json", "MOVE LEFT-ARM TO POSITION 60 -20 35 CM")
    assert status == 0
    assert json.loads(out.splitlines()[-1]) == {
        "type": "ParsedCommand",
        "kind": "task",
        "verb": "MOVE",
        "hand": "LEFT-ARM",
        "place": {"position": [0.6, -0.2, 0.35]},
    }


def test_parse_json_is_the_refusal() -> None:
    status, out, _ = run("parse", "GRAPS X", "--json")
    refusal = json.loads(out.splitlines()[-1])
    assert status == 2
    assert (refusal["reason"], refusal["column"], refusal["nearest"]) == ("sentence", 0, ["GRASP"])


def test_parse_survives_what_a_terminal_may_send() -> None:
    status, _, err = run("parse", "GRASP \udcff")  # a byte that is no UTF-8, as Python hands it over
    assert status == 2
    assert "U+DCFF" in err


def test_dictionary_prints_an_entry() -> None:
    assert run("dictionary", "grasp") == (0, dictionary.entry("GRASP"), "")


@pytest.mark.parametrize("word", ["REPORT", "slip", "TOGETHER_WITH"])
def test_dictionary_prints_the_clauses_of_a_word_that_is_no_verb(word: str) -> None:
    status, out, err = run("dictionary", word)
    name = word.upper().replace("_", "-")
    assert (status, err) == (0, "")
    assert out.startswith(f"{name}: {dictionary.meanings().words[name]}\n")
    assert f"--> {name}" in out


def test_dictionary_refuses_what_is_no_word() -> None:
    status, out, err = run("dictionary", "REPROT")
    assert (status, out) == (2, "")
    assert "REPORT" in err


def test_dictionary_lists_the_verbs() -> None:
    status, out, _ = run("dictionary")
    assert status == 0
    assert [line.split()[0] for line in out.splitlines()] == dictionary.verbs()


def test_dictionary_marks_what_nothing_does_yet() -> None:
    lines = {line.split()[0]: line for line in run("dictionary")[1].splitlines()}
    unscripted = {verb for verb, line in lines.items() if line.endswith("(no script yet)")}
    refused = {verb for verb, line in lines.items() if line.endswith("(refused today)")}
    assert unscripted == set()
    assert refused == set()
    assert run("dictionary", "DONE")[2] == ""


def test_no_word_of_the_dictionary_is_called_refused_that_is_performed() -> None:
    """Each verb is performed by the broker, answers the operator, or has a script; each clause is read by a script."""
    scripted = {row.verb for row in language._elaborator().decision_tree if row.enabled}
    assert set(dictionary.verbs()) == scripted | language.BY_THE_BROKER
    assert set(ANSWERS) <= language.BY_THE_BROKER
    for word in ("UNTIL", "TAKE", "DONE", "CANNOT"):
        assert "refused" not in run("dictionary", word)[1]


def test_dictionary_of_an_unknown_verb() -> None:
    status, out, err = run("dictionary", "GRAPS")
    assert (status, out) == (2, "")
    assert "nearest: GRASP" in err


def test_grammar_prints_the_bnf() -> None:
    assert run("grammar") == (0, dictionary.bnf(), "")


def test_grammar_stats() -> None:
    status, out, _ = run("grammar", "--stats")
    counts = {line[:15].strip(): int(line[15:]) for line in out.split("\n\n")[1].splitlines()}
    assert status == 0
    assert counts == {key.replace("_", " "): n for key, n in dictionary.stats().items()}
    assert out.count("\n") == len(dictionary.clauses()) + 1 + len(counts)


@pytest.mark.parametrize("command", ["parse", "dictionary", "grammar"])
def test_help_has_an_example(command: str) -> None:
    status, out, _ = run(command, "--help")
    assert status == 0
    assert f"Example: rtc {command}" in out

"""Numbers in YAML are what people mean by them, for every reader of files that people write."""

from __future__ import annotations

import ast
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from rtc.apps.authoring.review import review
from rtc.model.cells import yaml_reader
from rtc.model.cells.cell import CELLS, Cell
from rtc.programs import loader, whole_file
from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import ProgramError
from tests.source_files import ROOT
from tests.test_architecture import ALL, place


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("4e-2", 0.04),
        ("1e3", 1000.0),
        ("4.E-2", 0.04),
        (".5", 0.5),
        ("+.5e+1", 5.0),
        ("010", 10),
        ("-007", -7),
        ("0o17", 15),
        ("0x1F", 31),
        ("08", 8),
        ("08.5", 8.5),
        ("1:30", "1:30"),
        ("190:20:30.15", "190:20:30.15"),
        ("1_000", "1_000"),
        ("0b11", "0b11"),
        ("on", "on"),
        ("NO", "NO"),
        ("2001-01-01", "2001-01-01"),
        ("=", "="),
        ("true", True),
        ("~", None),
        ("", None),
        ("0.5 m", "0.5 m"),
    ],
)
def test_a_plain_scalar_has_the_value_of_yaml_1_2(text, value) -> None:
    read = yaml_reader.read(f"a: {text}".encode(), "file")["a"]
    assert (read, type(read)) == (value, type(value))


@pytest.mark.parametrize(
    "text", [".inf", "-.INF", "+.inf", ".nan", ".NaN", "1e400", "-1e309", "9" * 5000, "!!float .inf"]
)
def test_a_number_that_is_not_finite_is_refused_with_line_and_field(text) -> None:
    with pytest.raises(yaml_reader.Unreadable) as refused:
        yaml_reader.read(f"name: x\narms:\n  - {{a: 1}}\n  - a: 1\n    xyz: [0, {text}, 0]\n".encode(), "file")
    assert (refused.value.where, refused.value.line) == ("$.arms[1].xyz[1]", 5)


def test_maps_of_braces_are_json_or_yaml() -> None:
    assert yaml_reader.read(b'{"a": 1e2, "b": [true]}', "file") == {"a": 100.0, "b": [True]}
    assert yaml_reader.read(b"{a: 1e2, b: [true]}", "file") == {"a": 100.0, "b": [True]}
    with pytest.raises(yaml_reader.Unreadable) as refused:
        yaml_reader.read(b'{"a": 1,\n "b": 1e400}', "file")
    assert (refused.value.where, refused.value.line) == ("$.b", 2)


# --- all readers ---------------------------------------------------------------------------------------

#: the factor by which one number of a small document is replaced
SPELLINGS = {"4e-2": 0.04, "010": 10.0, "5": 5.0, ".25": 0.25}


def _of_cell(text: str, folder: Path, extends: str = "", flow: bool = False) -> Path:
    """A cell file whose `payload_kg` is spelt so."""
    plain = (CELLS / "panda" / "cell.yaml").read_text()
    if extends:
        plain = f"name: mine\nextends: panda\narms: [{{name: PANDA, payload_kg: {text}}}]\n"
    elif flow:
        plain = f"{{name: mine, extends: panda, arms: [{{name: PANDA, payload_kg: {text}}}]}}\n"
    else:
        plain = plain.replace("payload_kg: 3\n", f"payload_kg: {text}\n")
        for file in (CELLS / "panda").iterdir():
            if file.name != "cell.yaml":
                (folder / file.name).symlink_to(file)
    (folder / "cell.yaml").write_text(plain)
    return folder / "cell.yaml"


def _embedded(text: str, folder: Path) -> float:
    document = Cell.load("panda").encode().replace(b'"payload_kg":3.0', f'"payload_kg":{text}'.encode())
    return Cell.from_bytes(document).arms[0].payload_kg


def _reviewed(text: str, folder: Path) -> float:
    findings, cell = review(_of_cell(text, folder))
    if cell is None:
        raise ProgramError("; ".join(f"{one.line} {one.where}: {one.problem}" for one in findings))
    return cell.arms[0].payload_kg


def _of_program(text: str, folder: Path) -> float:
    return float(loader._read(f"speed: {text}\n".encode(), "program")["speed"])


def _of_whole_file(text: str, folder: Path) -> float:
    parts = whole_file.sections(f"binder:\n  speed: {text}\n".encode(), "verb.yaml")
    return float(loader._read(parts[WorkerKind.BINDER], "verb.yaml")["speed"])


READERS: dict[str, Callable[[str, Path], float]] = {
    "load": lambda text, folder: Cell.load(_of_cell(text, folder)).arms[0].payload_kg,
    "extends": lambda text, folder: Cell.load(_of_cell(text, folder, "panda")).arms[0].payload_kg,
    "flow": lambda text, folder: Cell.load(_of_cell(text, folder, flow=True)).arms[0].payload_kg,
    "embedded": _embedded,
    "review": _reviewed,
    "program": _of_program,
    "whole file": _of_whole_file,
}


@pytest.mark.parametrize("spelling", SPELLINGS)
@pytest.mark.parametrize("reader", READERS)
def test_every_reader_has_the_same_numbers(reader, spelling, tmp_path) -> None:
    assert READERS[reader](spelling, tmp_path) == SPELLINGS[spelling]


@pytest.mark.parametrize("spelling", [".inf", ".nan", "1e400"])
@pytest.mark.parametrize("reader", READERS)
def test_every_reader_refuses_what_is_not_finite_with_its_field(reader, spelling, tmp_path) -> None:
    with pytest.raises(ProgramError, match=r"payload_kg|speed"):
        READERS[reader](spelling, tmp_path)


@pytest.mark.parametrize("spelling", ["1:30", "1_000"])
@pytest.mark.parametrize("reader", [name for name in READERS if name not in ("program", "whole file")])
def test_every_reader_of_cells_refuses_a_text_for_a_number(reader, spelling, tmp_path) -> None:
    with pytest.raises(ProgramError, match="payload_kg"):
        READERS[reader](spelling, tmp_path)


def test_a_check_states_the_text_that_stands_for_a_number(tmp_path) -> None:
    findings, _ = review(_of_cell("1:30", tmp_path))
    errors = [one for one in findings if one.severity == "error"]
    assert [(one.where, "1:30" in one.problem, one.line > 0) for one in errors] == [
        ("$.arms[0].payload_kg", True, True)
    ]


def test_a_check_states_the_line_of_a_number_that_is_not_finite(tmp_path) -> None:
    file = _of_cell(".inf", tmp_path)
    findings, _ = review(file)
    line = next(n for n, text in enumerate(file.read_text().splitlines(), 1) if "payload_kg" in text)
    assert [(one.where, one.line) for one in findings] == [("$.arms[0].payload_kg", line)]


def test_no_other_module_loads_yaml() -> None:
    """Another loader would read the same file with other numbers."""
    wrong = [
        f"{place(path)}:{node.lineno} {ast.unparse(node)}"
        for path in ALL
        if place(path)
        not in ("rtc/model/cells/yaml_reader.py", "rtc/language/dictionary.py")  # it reads a file of ours
        if "yaml" in (text := path.read_text())  # most files are not parsed
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Attribute)
        and (
            (node.attr in ("yaml", "CSafeLoader") and ast.unparse(node) in ("msgspec.yaml", "yaml.CSafeLoader"))
            or (
                node.attr.startswith(("load", "safe_load", "full_load", "unsafe_load", "compose", "parse", "scan"))
                and hasattr(yaml, node.attr)
                and ast.unparse(node.value) == "yaml"
            )
        )
    ]
    assert wrong == []


def test_all_files_of_ours_have_the_values_that_they_had() -> None:
    """No file of ours relies on what only YAML 1.1 reads."""
    for file in sorted(one for folder in ("rtc", "examples") for one in (ROOT / folder).rglob("*.yaml")):
        text = file.read_bytes()
        assert yaml_reader.read(text, file.name) == yaml.load(text, yaml.CSafeLoader), file

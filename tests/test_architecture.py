"""The shape of the code base, tested: who imports whom, what may be imported where, what code must not name."""

from __future__ import annotations

import ast
import functools
import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from rtc.model.cells.cell import Cell
from rtc.protocol.subsystems import DEFAULTS
from tests import modules_page
from tests.source_files import ROOT, place, source

PACKAGES = ("rtc", "broker", "workers", "sim_mcm", "deploy")
#: package -> those of ours it may import; the last entry that fits counts
ARROWS = {
    "rtc": {"rtc"},
    "broker": {"rtc", "broker"},
    "workers": {"rtc", "workers"},
    "sim_mcm": {"rtc", "sim_mcm"},
    "deploy": {"rtc", "deploy"},
    "deploy/engines": {"rtc", "deploy", "workers"},  # launchers of workers
}
#: libraries of engines that run workers
ENGINES = ("ray", "dask", "distributed", "kubernetes", "nomad", "submitit")
#: outside module -> the places that may import it
ONLY_IN = {
    "pybullet": ("sim_mcm/",),
    "PIL": ("sim_mcm/cameras/picture.py",),
    "pyapriltags": ("rtc/sensing/detector.py",),
    "pinocchio": ("rtc/model/robot/", "rtc/apps/authoring/", "workers/planning/motion/", "sim_mcm/"),
    "coal": ("rtc/model/robot/", "rtc/apps/authoring/", "workers/planning/motion/", "sim_mcm/"),
    "lark": ("rtc/language/",),
    "typer": ("rtc/apps/cli/",),
    "mcap": ("rtc/apps/observers/",),
    "mcap_protobuf": ("rtc/apps/observers/",),
    "foxglove_schemas_protobuf": ("rtc/apps/observers/",),
    "prometheus_client": ("rtc/apps/observers/",),
    "opentelemetry": ("rtc/apps/observers/",),
    **dict.fromkeys(ENGINES, ("deploy/engines/",)),
    "sqlite3": ("rtc/world/", "rtc/client/past_runs.py", "rtc/runtime/damaged_database.py", "broker/"),
}
#: pure packages and files: no clock, no socket, no process, no chance
PURE = (
    "rtc/protocol/", "rtc/language/", "rtc/wording/", "rtc/spatial/", "rtc/model/robot/", "rtc/model/cells/cell.py",
    "rtc/model/cells/parts.py",
    "workers/parser/", "workers/elaborator/", "workers/binder/", "workers/analyzer/", "workers/planning/",
    "workers/conditions/", "workers/rehearsal/", "workers/tasks/", "workers/mechanisms/",
    "rtc/programs/action_stack.py",
    "rtc/programs/schema.py", "rtc/programs/checks.py", "rtc/programs/expressions.py", "rtc/programs/compatibility.py",
    "rtc/programs/attributes.py", "rtc/programs/recovery.py", "rtc/programs/splice.py", "rtc/programs/whole_file.py",
    "rtc/programs/plugin_fields.py", "rtc/programs/words_of_packages.py", "rtc/programs/loader.py",
    "rtc/world/facts.py", "rtc/world/model.py", "rtc/world/spread.py",
    "broker/decisions/", "broker/dispatch/", "rtc/subsystems/motion/",
    "rtc/client/core.py", "rtc/apps/observers/viewer_schema.py", "rtc/sensing/", "rtc/subsystems/base/subsystem.py",
    "rtc/subsystems/perception/camera.py", "rtc/subsystems/perception/motion.py",
    "rtc/subsystems/perception/subsystem.py",
)  # fmt: skip
#: packages whose modules all lie in packages of their own
ROOMS = ("rtc", "workers", "rtc.model", "rtc.subsystems", "rtc.apps")
IMPURE = {"time", "random", "socket", "zmq", "sqlite3", "subprocess", "threading", "multiprocessing", "uuid", "logging"}
#: what knows phases and outcomes, never skills
SKILLESS = (
    "broker/",
    "workers/runtime/",
    "workers/binder/",
    "workers/elaborator/",
    "workers/analyzer/",
    "workers/rehearsal/",
)


def sources(*folders: str) -> list[Path]:
    return sorted(p for folder in folders for p in (ROOT / folder).rglob("*.py") if "__pycache__" not in p.parts)


ALL = sources(*PACKAGES)


def test_there_is_something_to_look_at() -> None:
    assert {place(path).split("/")[0] for path in ALL} == set(PACKAGES)


def test_imports_go_one_way() -> None:
    wrong = [
        f"{place(path)}:{line} imports {name}"
        for path in ALL
        for line, name in source(path).imports
        if (top := name.split(".")[0]) in ARROWS and top not in may_import(place(path))
    ]
    assert wrong == []


def may_import(where: str) -> set[str]:
    return next(ARROWS[name] for name in reversed(ARROWS) if where.startswith(f"{name}/"))


def test_an_outside_library_stays_in_its_place() -> None:
    wrong = [
        f"{place(path)}:{line} imports {name}"
        for path in ALL
        for line, name in source(path).imports
        if (homes := ONLY_IN.get(name.split(".")[0])) and not place(path).startswith(homes)
    ]
    assert wrong == []


def test_a_pure_module_reaches_no_clock_no_socket_and_no_chance() -> None:
    """Checked through everything of ours that it imports, so that no detour leads to a clock."""
    wrong = [
        f"{place(path)} reaches {name} by {' -> '.join(way)}"
        for path in ALL
        if place(path).startswith(PURE)
        for way, names in reached(path)
        for name in sorted(names & IMPURE)
    ]
    assert wrong == []


def reached(path: Path) -> Iterator[tuple[list[str], set[str]]]:
    """(the way of imports to a module of ours, the outside modules that this imports) for all that `path` loads."""
    modules = loaded()
    open_ways, seen = [[module(path)]], {module(path)}
    while open_ways:
        way = open_ways.pop()
        ours, others = modules[way[-1]]
        yield way, others
        for name in ours - seen:
            seen.add(name)
            open_ways.append([*way, name])


@functools.cache
def loaded() -> dict[str, tuple[set[str], set[str]]]:
    """Module -> what it imports when it is loaded: modules of ours, and outside packages."""
    names = {module(path) for path in ALL}
    tops = {module(path): source(path).at_top for path in ALL}
    return {name: (set(top & names), {one.split(".")[0] for one in top - names}) for name, top in tops.items()}


@pytest.mark.parametrize("package", ROOMS)
def test_no_module_lies_loose_in_a_package_of_rooms(package: str) -> None:
    loose = {path.name for path in (ROOT / package.replace(".", "/")).glob("*.py")} - {"__init__.py", "__main__.py"}
    assert not loose


#: processes of a cluster that serve clients, so they must not load the client
SERVERS = (
    "broker/__main__.py",
    "sim_mcm/__main__.py",
    "sim_mcm/cameras/__main__.py",
    "workers/__main__.py",
    "rtc/world/__main__.py",
)


@pytest.mark.parametrize("path", [ROOT / name for name in SERVERS], ids=place)
def test_a_server_does_not_load_the_client(path: Path) -> None:
    """Through everything of ours that it imports, also inside functions."""
    ways, seen = [[module(path)]], {module(path)}
    while ways:
        way = ways.pop()
        assert not way[-1].startswith("rtc.client"), " -> ".join(way)
        for name in sorted(import_graph()[way[-1]] - seen):
            seen.add(name)
            ways.append([*way, name])


def test_no_other_package_imports_the_applications() -> None:
    """The command line, the demos and the observers use everything else; nothing else needs them."""
    wrong = [
        f"{name} imports {other}"
        for name, others in import_graph().items()
        for other in sorted(others)
        if other.startswith("rtc.apps.") and not name.startswith("rtc.apps.")
    ]
    assert wrong == []


def test_packages_make_no_cycle() -> None:
    """Packages directly in a package of rooms, and the other top-level packages as wholes."""
    rooms: dict[str, set[str]] = {}
    for name, others in import_graph().items():
        rooms.setdefault(room(name), set()).update({room(other) for other in others} - {room(name)})
    assert cycle(rooms) == []


def room(name: str) -> str:
    parts = name.split(".")
    depth = next(n for n in range(1, len(parts) + 1) if ".".join(parts[:n]) not in ROOMS or n == len(parts))
    return ".".join(parts[:depth])


@functools.cache
def import_graph() -> dict[str, set[str]]:
    """Module -> those of ours that it imports: at the top, inside functions, under TYPE_CHECKING, and by name."""
    modules = {module(path) for path in ALL}
    return {module(path): set(source(path).modules & modules - {module(path)}) for path in ALL}


def test_imports_make_no_cycle() -> None:
    """Also not under TYPE_CHECKING or inside functions."""
    assert cycle(import_graph()) == []


def cycle(graph: dict[str, set[str]]) -> list[str]:
    """The modules of one cycle in order, the first of them also at the end; empty if there is none."""
    done: set[str] = set()

    def visit(name: str, way: list[str]) -> list[str]:
        if name in way:
            return [*way[way.index(name) :], name]
        if name in done:
            return []
        for other in sorted(graph[name]):
            if found := visit(other, [*way, name]):
                return found
        done.add(name)
        return []

    return next((found for name in sorted(graph) if (found := visit(name, []))), [])


#: what the folder of a mechanism may import of `workers`, besides its own modules
BELOW_MECHANISMS = ("workers.tasks", "workers.planning", "workers.conditions", "workers.mechanisms.mechanism")


def test_a_mechanism_knows_no_stage_and_no_other_mechanism() -> None:
    wrong = [
        f"{name} imports {other}"
        for name, others in import_graph().items()
        if (folder := ".".join(name.split(".")[:3])).startswith("workers.mechanisms.") and folder != name
        for other in sorted(others)
        if other.startswith("workers.") and not other.startswith((folder, *BELOW_MECHANISMS))
    ]
    assert wrong == []


def test_the_mechanism_of_the_page_for_users_keeps_this_rule() -> None:
    page = (ROOT / "docs" / "own-mechanism.md").read_text()
    (code, _) = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    used = re.findall(r"^(?:from|import) (\S+)", code, re.MULTILINE)
    assert used
    assert [name for name in used if name.startswith("workers") and not name.startswith(BELOW_MECHANISMS)] == []


def test_a_cycle_is_found() -> None:
    assert cycle({"a": {"b", "c"}, "b": set(), "c": {"d"}, "d": {"c"}}) == ["c", "d", "c"]
    assert cycle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def module(path: Path) -> str:
    return place(path).removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def test_only_what_people_see_makes_words_of_facts() -> None:
    graph = import_graph()
    users = {name for name, used in graph.items() if any(one.startswith("rtc.wording") for one in used)}
    assert {name for name in users if not name.startswith(("rtc.apps.", "rtc.wording."))} == set()


#: texts of messages for people, and what would take one apart
TEXTS = {"step", "note", "message", "found", "drift", "words", "clears"}
TAKES_APART = {
    *("match", "fullmatch", "search", "findall", "finditer", "sub", "split", "rsplit", "splitlines"),
    *("startswith", "endswith", "removeprefix", "removesuffix", "partition", "rpartition", "find", "index"),
}


#: the client for asyncio has the names of the one with threads
ALIKE = {"Client", "CommandHandle"}


def test_no_two_classes_have_one_name() -> None:
    names = Counter(name for path in ALL for name in re.findall(r"^ *class (\w+)", path.read_text(), re.MULTILINE))
    assert {name for name, count in names.items() if count > 1} == ALIKE


def test_no_code_takes_the_text_of_a_message_apart() -> None:
    folders = ("rtc", "broker", "workers", "sim_mcm", "deploy", "tests/campaigns", "examples", "benchmarks")
    files = [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]
    found = {place(path): taken_apart(path.read_text()) for path in files}
    assert {where: lines for where, lines in found.items() if lines} == {}


def taken_apart(text: str) -> list[str]:
    """Calls of a regular expression or of a method of strings on the text of a message."""
    calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    return [
        ast.unparse(call)
        for call in calls
        if isinstance(call.func, ast.Attribute) and call.func.attr in TAKES_APART
        if any(isinstance(part, ast.Attribute) and part.attr in TEXTS for part in (call.func.value, *call.args))
    ]


def test_tests_look_at_facts_and_where_they_read_a_message_they_say_why() -> None:
    """By a comment that begins with "wording"."""
    files = sorted((ROOT / "tests").rglob("*.py"))
    assert [line for path in files for line in read_messages(path)] == []


def read_messages(path: Path) -> list[str]:
    text = path.read_text()
    lines = text.splitlines()
    return [
        f"{place(path)}:{node.lineno}"
        for node in (ast.walk(ast.parse(text)) if ".message" in text else ())
        if isinstance(node, ast.Assert)
        if any(isinstance(part, ast.Attribute) and part.attr == "message" for part in ast.walk(node.test))
        if not any("# wording" in line for line in lines[node.lineno - 1 : node.end_lineno])
    ]


@pytest.mark.parametrize(
    "line", ["HALT.fullmatch(note.message)", "note.found.partition(': ')", "re.sub('a', '', n.note)"]
)
def test_a_text_that_is_taken_apart_is_found(line: str) -> None:
    assert taken_apart(line) == [line]


def test_code_names_no_skill() -> None:
    """Skills, objects and verbs of motion are data: a new one is a file, not a change here."""
    found = {place(path): source(path).texts & skill_names() for path in ALL if place(path).startswith(SKILLESS)}
    assert [row for row in found.items() if row[1]] == []


@functools.cache
def skill_names() -> set[str]:
    """Verbs of the decision tree and names of scripts, as the programs have them (but for plain English words)."""
    programs = ROOT / "rtc" / "programs" / "default" / "elaborator"
    tree = yaml.safe_load((programs / "decision_tree.yaml").read_text())["decision_tree"]
    scripts = (yaml.safe_load(path.read_text()).get("script", "") for path in (programs / "scripts").glob("*.yaml"))
    return {row["verb"] for row in tree} | {name for name in scripts if "-" in name}


def test_every_phase_of_a_command_is_a_word_people_see() -> None:
    """One idea, one name: docs/glossary.md has the words that messages use."""
    glossary = (ROOT / "docs" / "glossary.md").read_text()
    words = ("sentence", "command", "job", "program", "script", "step", "primitive", "subsystem", "report", "trim")
    missing = [word for word in words if not re.search(rf"^\| {word} \|", glossary, re.MULTILINE)]
    assert not missing


def test_the_environment_is_read_in_one_place() -> None:
    readers = {place(path) for path in ALL if re.search(r"environ\[|environ\.get|getenv", path.read_text())}
    assert readers <= {"rtc/runtime/environment.py"}


def test_this_python_is_one_we_support() -> None:
    assert sys.version_info >= (3, 11)


def test_the_page_of_modules_is_up_to_date() -> None:
    written = (ROOT / "docs" / "modules.md").read_text()
    assert written == modules_page.page(), "write it anew: python -m tests.modules_page > docs/modules.md"


def test_every_module_states_its_purpose() -> None:
    assert [place(path) for path in ALL if not modules_page.first_paragraph(path)] == []


def test_no_code_names_a_subsystem_or_an_arm() -> None:
    """The cell names its arms and subsystems; those of every cell stand in `rtc/protocol/subsystems.json`. Demos show
    one cell."""
    names = {one.name for one in DEFAULTS} | {arm.name for arm in Cell.load("swapout").arms}
    found = {place(path): source(path).texts & names for path in ALL}
    assert [row for row in found.items() if row[1] and not row[0].startswith("rtc/apps/demos/")] == []

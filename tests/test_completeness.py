"""Nothing is declared and then not done: verbs, trims, members of enumerations, fields, names for programs, messages.

What is understood but has no effect is the worst defect of a language. These tests compare declarations with the code
and the programs that would have to use them, by name: each declaration needs at least one place that does.
"""

from __future__ import annotations

import ast
import re
import types
from functools import cache
from pathlib import Path

import pytest

from rtc.language import dictionary
from rtc.programs import expressions, extension_names, loader
from rtc.programs.loader import decode
from rtc.programs.schema import ElaboratorProgram, ScriptFile
from rtc.protocol import causes, messages

ROOT = Path(__file__).parents[1]
CODE = ("rtc", "broker", "workers", "sim_mcm", "deploy")
OF_OPERATOR = {"GIVE", "TAKE", "DONE", "CANNOT"}  # verbs of the operator
#: messages that are no member of a union: products of jobs, a record of the journal, and sockets with one message
OFF_SOCKETS = {
    *("Script", "Rehearsed", "BoundStep", "Assessment", "CommandRecord"),
    *("Telemetry", "Operate", "OperateReply"),
}
#: messages that the code does not construct: packed from journalled bytes, or made by the operator's programs
MADE_OUTSIDE = {"Execute", "Operate", "OperatorAnswer"}
COMMON = "look-where-it-stands"  # of nearly all scripts: where an arm is that has crept

#: fields that no code of the project reads: they are for readers outside, who get them by this name
FOR_OTHERS = {
    "SubsystemHalt.receipt_s": "an answer of `rtc.client.halt`, for programs of users",
    "SubsystemHalt.own_rest_s": "an answer of `rtc.client.halt`; `examples/swapout` reads it",
    "ObjectRow.true_pose": "a row of `rtc look --json`",
    "WorkerRow.mean_ms": "a row of `rtc status --json`, and of `benchmarks.scaling`",
    "ArmSample.operation": "what an operator is asked to do, for the program of a hand controller",
}
#: members that are made from a text or number, with the code that does it
CONVERTED = {
    "Role": "Role(role)",  # of `rtc keys new`
    "Action": "Action(self._last + 1)",
}


# --- verbs and trims -------------------------------------------------------------------------------------


@cache
def program() -> ElaboratorProgram:
    return decode(loader.default("elaborator"), ElaboratorProgram)


def scripts_of(verb: str) -> list[ScriptFile]:
    names = {branch.script for branch in program().decision_tree if branch.verb == verb and branch.enabled}
    return [script for script in program().scripts if script.script in names]


def test_each_verb_has_a_script_or_is_performed_by_the_broker():
    by_broker = {production[0] for production in dictionary.clauses()["control"]} | {"TEST", "LOAD"}
    without = [verb for verb in dictionary.verbs() if not scripts_of(verb) and verb not in by_broker | OF_OPERATOR]
    assert without == []
    for verb in by_broker:
        assert literals()[verb], f"no code of the broker names {verb}"


def test_each_script_is_used_by_a_verb_of_the_language():
    assert {branch.verb for branch in program().decision_tree} <= set(dictionary.verbs())
    used = {branch.script for branch in program().decision_tree}
    assert {script.script for script in program().scripts} == used


@pytest.mark.parametrize("verb", dictionary.verbs())
def test_the_trims_of_the_dictionary_are_those_of_the_scripts(verb: str):
    promised = {name for way in dictionary.meanings().verbs.get(verb, []) for name in way.trims}
    stacks = {entry.skill for script in scripts_of(verb) for entry in script.trimming_stack} - {COMMON}
    assert promised == {re.sub(r"-\d+$", "", name) for name in stacks}


@pytest.mark.parametrize("verb", dictionary.verbs())
def test_each_piece_that_a_verb_promises_for_and_try_can_be_tried(verb: str):
    """A script of the verb has the poses and the figures of the piece (as the elaborator checks for one sentence)."""
    pieces = {piece.skill.upper(): piece for piece in program().pieces}
    rows = [row.values for row in program().command_object_table if row.verb == verb]
    for name in (name for way in dictionary.meanings().verbs.get(verb, []) for name in way.tries):
        steps = pieces[name].steps
        poses = {step.to for step in steps} | {step.words.get("about", "") for step in steps}
        figures = {n for step in steps for value in step.args.values() for n in expressions.names(str(value))}
        plans = [{"", "HERE", *(line.name for line in script.plan)} for script in scripts_of(verb) if script.case >= 3]
        assert any(poses <= plan for plan in plans), name
        assert any(figures <= {*extension_names.FIGURES, *row} for row in rows), name


def test_each_piece_of_script_is_used():
    """By a trimming stack, to sense something first, by AND TRY, or as a step of a script."""
    used = {entry.skill for script in program().scripts for entry in script.trimming_stack}
    used |= {*program().senses.values(), *(entry.skill for entry in program().reserve)}
    used |= {name.lower() for ways in dictionary.meanings().verbs.values() for way in ways for name in way.tries}
    used |= {step.name for script in program().scripts for step in script.steps if step.do == "piece"}
    assert {piece.skill for piece in program().pieces} - used == set()


# --- names for programs ----------------------------------------------------------------------------------


@pytest.mark.parametrize("table", ["NEEDS", "ANCHORS", "SPACES", "ROLES"])
def test_each_name_that_programs_may_use_is_used_by_a_program_or_documented(table: str):
    documents = "\n".join((ROOT / "docs" / name).read_text() for name in ("scripts.md", "plugins.md", "language.md"))
    unused = [name for name in getattr(extension_names, table) if name not in words_of_programs()]
    assert [name for name in unused if name not in documents] == []


# --- enumerations, fields and messages -------------------------------------------------------------------


@cache
def trees() -> dict[Path, ast.Module]:
    files = [path for folder in CODE for path in (ROOT / folder).rglob("*.py")]
    return {path: ast.parse(path.read_text()) for path in files}


@cache
def words_of_programs() -> frozenset[str]:
    """All words of the programs and cells that come with the project, without comments."""
    lines = (
        line for folder in CODE for path in (ROOT / folder).rglob("*.yaml") for line in path.read_text().split("\n")
    )
    return frozenset(word for line in lines for word in re.findall(r"[\w-]+", line.partition(" #")[0]))


class Uses(ast.NodeVisitor):
    """What the code makes and reads: members of enumerations, attributes, texts, calls."""

    def __init__(self) -> None:
        self.made: set[tuple[str, str]] = set()  # (name before the dot, member), but not where it is only compared
        self.read: set[str] = set()
        self.called: set[str] = set()
        self.texts: dict[str, int] = {}
        self.aliases: dict[str, str] = {}
        self._compares = 0

    def visit_Assign(self, node: ast.Assign) -> None:
        for target in node.targets:
            names, values = (x.elts if isinstance(x, ast.Tuple) else [x] for x in (target, node.value))
            for name, value in zip(names, values, strict=False):
                if isinstance(name, ast.Name) and isinstance(value, ast.Name):
                    self.aliases[name.id] = value.id
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        self._comparing(node)

    def visit_MatchValue(self, node: ast.MatchValue) -> None:
        self._comparing(node)

    def _comparing(self, node: ast.AST) -> None:
        self._compares += 1
        self.generic_visit(node)
        self._compares -= 1

    def visit_MatchClass(self, node: ast.MatchClass) -> None:
        self.read.update(node.kwd_attrs)
        self.generic_visit(node)

    def visit_Dict(self, node: ast.Dict) -> None:
        for key in filter(None, node.keys):
            self._comparing(key)
        for value in node.values:
            self.visit(value)

    def visit_Attribute(self, node: ast.Attribute) -> None:
        before = node.value
        owner = before.id if isinstance(before, ast.Name) else before.attr if isinstance(before, ast.Attribute) else ""
        if owner and not self._compares:
            self.made.add((owner, node.attr))
        if isinstance(node.ctx, ast.Load):
            self.read.add(node.attr)
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        if isinstance(node.func, ast.Name | ast.Attribute):
            self.called.add(node.func.id if isinstance(node.func, ast.Name) else node.func.attr)
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str):
            self.texts[node.value] = self.texts.get(node.value, 0) + 1


@cache
def uses() -> Uses:
    found = Uses()
    for tree in trees().values():
        found.visit(tree)
    return found


@cache
def read_by_pages() -> frozenset[str]:
    """The fields that the pages of the console read."""
    scripts = (path.read_text() for folder in CODE for path in (ROOT / folder).rglob("*.js"))
    return frozenset(name for text in scripts for name in re.findall(r"\.(\w+)", text))


def literals() -> dict[str, int]:
    return uses().texts


@cache
def classes() -> list[tuple[ast.ClassDef, list[str]]]:
    """(class, names of its bases without modules)."""
    return [
        (node, [ast.unparse(base).partition("[")[0].rpartition(".")[2] for base in node.bases])
        for tree in trees().values()
        for node in tree.body
        if isinstance(node, ast.ClassDef)
    ]


def test_each_member_of_an_enumeration_is_made_somewhere():
    made = {(uses().aliases.get(owner, owner), member) for owner, member in uses().made}
    sources = "\n".join(path.read_text() for path in trees())
    missing = []
    for node, bases in classes():
        if not any(base.endswith("Enum") for base in bases):
            continue
        assert node.name not in CONVERTED or CONVERTED[node.name] in sources
        for line in node.body:
            if isinstance(line, ast.Assign) and isinstance(line.targets[0], ast.Name):
                name, value = line.targets[0].id, ast.unparse(line.value).strip("'\"")
                in_program = value in words_of_programs()
                if (node.name, name) not in made and node.name not in CONVERTED and not in_program:
                    missing.append(f"{node.name}.{name}")
    assert missing == []


@cache
def structs() -> frozenset[str]:
    """Names of the data types: msgspec structs and dataclasses."""
    known = {"Struct"}
    found: frozenset[str] = frozenset()
    while found != frozenset(known):
        found = frozenset(known)
        for node, bases in classes():
            if known & {*bases} or any("dataclass" in ast.unparse(one) for one in node.decorator_list):
                known.add(node.name)
    return frozenset(known - {"Struct"})


def test_each_field_is_read_somewhere():
    """By attribute, by its name as a text, by programs, which name figures and fields of sentences, or by a page.

    `Refusal.figures` shows each cause whole."""
    known = uses().read | uses().texts.keys() | words_of_programs() | read_by_pages()
    unread = [
        f"{node.name}.{line.target.id}"
        for node, _ in classes()
        if node.name in structs() - vars(causes).keys()
        for line in node.body
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name) and line.target.id not in known
    ]
    assert sorted(set(unread) - FOR_OTHERS.keys()) == []


def test_each_message_is_made_somewhere_and_belongs_to_a_socket_or_a_job():
    unions = [kind for kind in vars(messages).values() if isinstance(kind, types.UnionType)]
    on_sockets = {kind.__name__ for union in unions for kind in union.__args__}
    kinds = {name for name, kind in vars(messages).items() if isinstance(kind, type) and name == kind.__name__}
    own = {name for name in kinds if issubclass(getattr(messages, name), messages.Message)} - {"Message", "Hello"}
    assert own - on_sockets == OFF_SOCKETS
    assert own - uses().called - MADE_OUTSIDE == set()

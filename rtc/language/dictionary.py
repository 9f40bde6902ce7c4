"""The command dictionary: an entry for each verb, in the form of Figure 2 of the paper, and grammar statistics.

Sources: command.lark (clauses and spellings) and dictionary.yaml (meanings). It neither parses a sentence nor compiles
the grammar, so look-ups are fast.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import lru_cache
from importlib import resources

import msgspec

from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.spelling import nearest_words

NIL = "nil"
ARROW = "-->"
RULE = re.compile(r"(?:([a-z_]+)|\s+\|)\s*:?((?: [A-Za-z_]+)*)\s+-> [a-z_]+")  # of command.lark: a production a line
CLASSES = {"NAME": "<name>", "STRING": "<string>", "NUMBER": "<number>", "QUANTITY": "<quantity>"}
TITLE = """\
-- RTC command language, version 1.  UPPER-CASE = reserved word (terminal);  <x> = token class;  nil = empty.
-- Lexer: case-insensitive, '_' == '-', commas and a final '.' are ignored, '--' starts a comment (as in Ada).
"""
RESERVED = re.compile(r"[A-Z][A-Z-]*")  # in the BNF, capitals are reserved words and <x> is a token class

Production = list[str]


class VerbUse(msgspec.Struct, frozen=True, rename={"kind": "class"}):
    """One way a verb works: a line of the table of commands."""

    kind: str
    resources: str  # non-sharable, allocated while the command runs
    steps: str
    success: str
    guarded: str  # the reflexes that GUARDED adds
    trims: dict[str, str] = {}  # piece of script -> what it does: used by the scripts themselves
    tries: dict[str, str] = {}  # the same for AND TRY
    of: str = ""  # the kind of object, for a verb with two ways


class Meanings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    words: dict[str, str]
    clauses: dict[str, str]
    verbs: dict[str, list[VerbUse]]
    examples: dict[str, list[str]]


def entry(word: str) -> str | Refusal:
    """The entry of a verb in the notation of Figure 2: its clause and all clauses that it uses. Of another word: its
    meaning, and the clauses that contain it.

    A synonym returns the entry of its word. An unknown word returns a refusal with the nearest words.
    """
    word = word.strip().upper().replace("_", "-")
    word = next((one for one, others in synonyms().items() if word in others), word)
    if word in verbs():
        return _of_verb(word)
    if word in meanings().words:
        return _of_word(word)
    return Refusal(
        reason=RefusalReason.NAME,
        message=f"{word!r} is not a word of the language.",
        expected=verbs(),
        nearest=nearest_words(word, {*verbs(), *meanings().words}),
    )


def _of_word(word: str) -> str:
    lines = [_heading(word)]
    for name, productions in clauses().items():
        if having := [one for one in productions if word in one]:
            lines += ["", *print_clause(name, having)]
            for other in _closure([symbol for one in having for symbol in one], [name]):
                lines += print_clause(other, clauses()[other])
    return "\n".join(lines) + "\n"


def _of_verb(verb: str) -> str:
    clause, production = _first_clause(verb)
    lines = [_heading(verb), "", *_examples(verb), *_ways(verb), "", *print_clause(clause, [production])]
    for name in _closure(production, [clause]):
        lines += print_clause(name, clauses()[name])
    if clause not in ("sentence", "control", "data", "operator"):
        lines += ["", f"After every task: {' '.join(_task_production()[1:])} (see `rtc grammar`)."]
    return "\n".join(lines) + "\n"


def verbs() -> list[str]:
    """All words that can begin a sentence, in the order of the grammar."""
    firsts: list[str] = []
    for production in clauses()["sentence"]:
        _add_firsts(production[0], firsts)
    return firsts


def stats() -> dict[str, int]:
    """Counts of the grammar. A terminal is a reserved word or a token class, a clause a left-hand side."""
    symbols = _symbols()
    classes = {s for s in symbols if s.startswith("<")}
    reserved = {s for s in symbols if RESERVED.fullmatch(s)}
    return {
        "terminals": len(reserved) + len(classes),
        "reserved_words": len(reserved),
        "token_classes": len(classes),
        "clauses": len(clauses()),
        "productions": sum(map(len, clauses().values())),
        "synonyms": sum(map(len, synonyms().values())),
    }


def reserved_words() -> frozenset[str]:
    """All words that cannot be a name: the reserved words and their synonyms."""
    others = (word for words in synonyms().values() for word in words)
    return frozenset({s for s in _symbols() if RESERVED.fullmatch(s)}.union(others))


def print_clause(name: str, productions: Iterable[Production]) -> list[str]:
    """Lines as in Figure 2: the clause once, an arrow before each alternative."""
    blank = " " * len(name)
    return [f"{blank if i else name} {ARROW} {' '.join(p) or NIL}" for i, p in enumerate(productions)]


@lru_cache(maxsize=1)
def clauses() -> dict[str, list[Production]]:
    """Clause -> its productions, each a list of symbols (empty for nil)."""
    found: dict[str, list[Production]] = {}
    for rule in filter(None, map(RULE.fullmatch, _text("command.lark").splitlines())):
        if rule[1]:
            productions = found[rule[1].replace("_", "-")] = []
        productions.append([CLASSES.get(symbol, symbol.replace("_", "-")) for symbol in rule[2].split()])
    return found


@lru_cache(maxsize=1)
def meanings() -> Meanings:
    return msgspec.yaml.decode(_text("dictionary.yaml"), type=Meanings)


@lru_cache(maxsize=1)
def synonyms() -> dict[str, list[str]]:
    """Reserved word -> its synonyms, if any. STOP for HALT is missing: its position decides (docs/language.md)."""
    found = {}
    for line in _text("command.lark").splitlines():
        spelt = re.fullmatch(r'[A-Z_]+: "([A-Z-]+)"((?: \| "[A-Z-]+")+)', line)
        if spelt:
            found[spelt[1]] = re.findall(r'"([A-Z-]+)"', spelt[2])
    return found


def bnf() -> str:
    """The grammar in Backus-Naur form, for people."""
    rows = (
        f"{'' if n else name:<20}{ARROW} {' '.join(symbols) or NIL}\n"
        for name, productions in clauses().items()
        for n, symbols in enumerate(productions)
    )
    return TITLE + "".join(rows)


def _symbols() -> set[str]:
    return {s for productions in clauses().values() for p in productions for s in p}


def _text(name: str) -> str:
    return resources.files("rtc.language").joinpath(name).read_text("utf-8")


def _add_firsts(symbol: str, firsts: list[str]) -> None:
    if RESERVED.fullmatch(symbol):
        if symbol not in firsts:
            firsts.append(symbol)
        return
    for production in clauses()[symbol]:
        if production:
            _add_firsts(production[0], firsts)


def _first_clause(verb: str) -> tuple[str, Production]:
    """The clause and production that begin the entry. For a one-word production, that is its sentence."""
    for name, productions in clauses().items():
        for production in productions:
            if production and production[0] == verb:
                if production != [verb]:
                    return name, production
                opened = next(p for p in clauses()["sentence"] if p[0] == name)
                return "sentence", [verb, *opened[1:]]
    raise AssertionError(f"{verb} is in verbs() but begins no production")


def _closure(production: Production, known: list[str]) -> list[str]:
    """The further clauses that a production uses, depth first as in Figure 2; `known` ones are left out."""
    found: list[str] = []
    for symbol in production:
        if symbol in clauses() and symbol not in known + found:
            found.append(symbol)
            needed = [s for p in clauses()[symbol] for s in p]
            found += _closure(needed, known + found)
    return found


def _task_production() -> Production:
    return next(p for p in clauses()["sentence"] if p[0] == "task")


def _heading(verb: str) -> str:
    others = synonyms().get(verb, [])
    also = f" (also {', '.join(others)})" if others else ""
    return f"{verb}{also}: {meanings().words[verb]}"


def _examples(verb: str) -> list[str]:
    heads = ["example", *[""] * len(meanings().examples[verb])]
    return [f"  {head:<10} {sentence}" for head, sentence in zip(heads, meanings().examples[verb], strict=False)]


def _trims(way: VerbUse) -> str:
    own, asked = (", ".join(f"{name} ({what})" for name, what in some.items()) for some in (way.trims, way.tries))
    return "; ".join(filter(None, (own or "none by itself", asked and f"AND TRY {asked}"))) if own or asked else "none"


def _ways(verb: str) -> list[str]:
    lines = []
    for way in meanings().verbs.get(verb, []):
        rows = {
            "class": way.kind,
            "resources": way.resources,
            "steps": way.steps,
            "success": way.success,
            "GUARDED": way.guarded,
            "trims": _trims(way),
        }
        lines += ["", f"{verb} {way.of}"] if way.of else []
        lines += [f"  {what:<10} {value}" for what, value in rows.items()]
    return lines

"""Programs are checked in a process of their own: an expensive one is refused in words, and no client waits for it."""

from __future__ import annotations

import pytest

from rtc.programs import loader
from rtc.programs.sandbox import CheckRequest, in_a_process
from rtc.protocol.messages import WorkerKind

GRAMMAR = loader.default(WorkerKind.PARSER)


def asked(body: bytes) -> CheckRequest:
    return CheckRequest(kind=WorkerKind.PARSER, name="mine.lark", body=body, reset=False, program=GRAMMAR, others={})


def test_a_grammar_that_compiles_is_taken():
    checked = in_a_process(asked(GRAMMAR + b"\n// mine\n"), cpu_s=10)
    assert (checked.error, checked.changes) == ("", ["the grammar is changed"])
    assert checked.merged.endswith(b"// mine\n")


@pytest.mark.parametrize(
    ("body", "why"),
    [
        (b"sentence: " + b"(" * 500 + b"A" + b")" * 500 + b'\nA: "A"\n', "nested too deeply"),
        (
            b"sentence: " + b" ".join([b"A?"] * 22) + b' -> control_sentence\nA: "A"\n',
            "more than 1 s of",
        ),
        (b'sentence: t{A}\nt{x}: t{t{x}}\nA: "A"\n', "takes|nested too deeply"),
    ],
    ids=["brackets", "options without end", "a template that calls itself"],
)
def test_a_grammar_that_costs_too_much_is_refused_in_words(body, why):
    error = in_a_process(asked(body), cpu_s=1).error
    assert error.startswith("mine.lark: ")
    assert any(words in error for words in why.split("|")), error

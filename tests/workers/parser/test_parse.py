"""The parser as a worker: a pure function of grammar and sentence."""

from importlib import resources

from rtc.language.parse import default_grammar, parse
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.sentence import ParsedCommand
from workers.parser.parse import parse_job

PROGRAM = resources.files("rtc.language").joinpath("command.lark").read_text()
SENTENCES = ["GRASP MACS-OLD GUARDED", "GRAPS MACS-OLD", "", "LIFT X BY 5 SEC"]


def test_a_job_gives_what_the_language_gives() -> None:
    for sentence in SENTENCES:
        assert parse_job(PROGRAM, sentence) == parse(default_grammar(), sentence)


def test_the_same_job_gives_the_same_whatever_came_between() -> None:
    others = [PROGRAM + f"// grammar {n}\n" for n in range(6)]  # more than are kept
    first = [parse_job(PROGRAM, s) for s in SENTENCES]
    for other in others:
        parse_job(other, "HALT")
    assert [parse_job(PROGRAM, s) for s in SENTENCES] == first


def test_bytes_are_a_sentence_too() -> None:
    assert isinstance(parse_job(PROGRAM, b"HALT"), ParsedCommand)
    assert isinstance(parse_job(PROGRAM, b"\xff"), Refusal)


def test_a_grammar_that_does_not_compile_is_a_refusal_of_the_program() -> None:
    refusal = parse_job("sentence: nonsense", "HALT")
    assert isinstance(refusal, Refusal)
    assert refusal.reason is RefusalReason.PROGRAM
    assert refusal.where == "the grammar"


def test_a_meaning_that_does_not_fit_its_production_is_a_refusal_of_the_program() -> None:
    program = PROGRAM.replace("LOCATE NAME                           -> command", "LOCATE NAME -> handoff")
    refusal = parse_job(program, "LOCATE MACS-OLD")
    assert isinstance(refusal, Refusal)
    assert refusal.reason is RefusalReason.PROGRAM
    assert parse_job(program, "GRASP MACS-OLD") == parse_job(PROGRAM, "GRASP MACS-OLD")

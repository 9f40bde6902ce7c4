"""The parser: (grammar, sentence) -> record or refusal.

A pure function: it knows no socket, no world and no other job. The compiled grammar is kept from job to
job only because compiling costs a fifth of a second; what a job gives never depends on that.
"""

from __future__ import annotations

from functools import lru_cache

from rtc.language.parse import Grammar, parse
from rtc.language.record import ParsedCommand
from rtc.messages import ParserInput
from rtc.outcomes import ProgramError, Refusal, RefusalReason

INPUT = ParserInput
NEEDS_WORLD = False
NEEDS_CELL = False

KEPT_GRAMMARS = 4  # the live one, the one before it, and two on trial


def compile(program: bytes) -> str:
    """The grammar's text, which compiles. Raises ProgramError."""
    try:
        text = program.decode()
    except UnicodeDecodeError as error:
        raise ProgramError(f"the grammar is no text: {error}") from error
    _compiled(text)
    return text


def run(compiled: str, cell: object, world: object, data: ParserInput) -> ParsedCommand | Refusal:
    """The record of one sentence; needs neither cell nor world."""
    return parse_job(compiled, data.text)


def parse_job(program: str, text: str | bytes) -> ParsedCommand | Refusal:
    """Parse one sentence by the grammar text `program`. Whatever the two are, nothing is raised."""
    try:
        return parse(_compiled(program), text)
    except ProgramError as error:
        return Refusal(reason=RefusalReason.PROGRAM, message=str(error), where="the grammar")
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        # A loaded grammar may give a meaning to a production that has not the parts this meaning needs.
        # That shows only when such a sentence comes: the program is at fault, the worker lives on.
        message = f"The grammar gives this sentence a meaning that does not fit its words ({error!r})."
        return Refusal(reason=RefusalReason.PROGRAM, message=message, where="the grammar")


@lru_cache(maxsize=KEPT_GRAMMARS)
def _compiled(program: str) -> Grammar:
    return Grammar(program)

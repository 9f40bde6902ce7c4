"""Parser worker function: (grammar, sentence) -> parsed record or refusal.

Pure: it uses no socket, no world and no other job. Compiled grammars are cached because compiling takes 0.2 s; the
result of a job never depends on the cache.
"""

from __future__ import annotations

from functools import lru_cache

from rtc.language.parse import Grammar, parse
from rtc.protocol.messages import ParserInput
from rtc.protocol.outcomes import ProgramError, Refusal, RefusalReason
from rtc.protocol.sentence import ParsedCommand

INPUT = ParserInput
NEEDS_WORLD = False
NEEDS_CELL = False

KEPT_SENTENCES = 1024  # records and refusals, which never change; plans repeat their sentences
KEPT_GRAMMARS = 4  # cached grammars: the live one, its predecessor and two on trial


def compile(program: bytes) -> str:
    """Decode and compile the grammar; returns its text. Raises ProgramError if it does not compile."""
    try:
        text = program.decode()
    except UnicodeDecodeError as error:
        raise ProgramError(f"the grammar is not valid UTF-8 text: {error}") from error
    _compiled(text)
    return text


def run(compiled: str, cell: object, world: object, data: ParserInput) -> ParsedCommand | Refusal:
    """Parse one sentence. `cell` and `world` are not used."""
    return parse_job(compiled, data.text)


@lru_cache(maxsize=KEPT_SENTENCES)
def parse_job(program: str, text: str | bytes) -> ParsedCommand | Refusal:
    """Parse one sentence by the grammar text `program`. Never raises: every error becomes a Refusal."""
    try:
        return parse(_compiled(program), text)
    except ProgramError as error:
        return Refusal(reason=RefusalReason.PROGRAM, message=str(error), where="the grammar")
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        # A loaded grammar may attach a meaning to a production that lacks the parts this meaning needs.
        # Only a sentence of that form shows the error: refuse the program and keep the worker.
        message = f"The grammar gives this sentence a meaning that does not fit its words ({error!r})."
        return Refusal(reason=RefusalReason.PROGRAM, message=message, where="the grammar")


@lru_cache(maxsize=KEPT_GRAMMARS)
def _compiled(program: str) -> Grammar:
    return Grammar(program)

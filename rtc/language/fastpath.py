"""Recognition of a plain HALT sentence in a microsecond, without the grammar.

A client calls this before it sends: a halt goes to the halt sockets at once and never waits for the parser. The
result must agree with the parser (a test compares them). Only a halt of everything, of an arm or of a command is
recognised here; any other halt is sent as an ordinary sentence.
"""

from __future__ import annotations

import re

from rtc.language.dictionary import reserved_words
from rtc.language.hands import ARM_OF_WORD
from rtc.language.refuse import MAX_CHARACTERS
from rtc.protocol.sentence import BOTH_ARMS

EVERYTHING = "ALL"
# BOTH-ARMS as ALL: with both arms halted, a command that needs an arm must not begin either
SCOPES = {**ARM_OF_WORD, BOTH_ARMS: EVERYTHING}

_NAME = r"[A-Z][A-Z0-9]*(?:[-_][A-Z0-9]+)*"
_HAND = "|".join(word.replace("-", "[-_]") for word in SCOPES)
_SENTENCE = re.compile(
    r"[ \t,]*(?:HALT|STOP)(?:[ \t,]+(?:"
    rf"(?P<ALL>ALL)|(?P<HAND>{_HAND})|(?P<COMMAND>C[-_]\d+)"
    rf"|ARM[ \t,]+(?P<ARM>{_NAME})))?"
    r"[ \t,]*(?:\.[ \t,]*)?(?:--.*)?",
    re.IGNORECASE | re.ASCII,
)
_FIRST_WORDS = ("HALT", "STOP")
_COMMAND = re.compile(r"C-\d+", re.ASCII)
_RESERVED = reserved_words()


def halt_scope(text: str) -> str | None:
    """The scope of a HALT or STOP sentence: `ALL`, an arm or a command id; None for any other text.

    Never raises, for any argument.
    """
    if not isinstance(text, str) or len(text) > MAX_CHARACTERS + len("\r\n"):
        return None
    if text.lstrip(" \t,")[:4].upper() not in _FIRST_WORDS:  # most sentences, and far quicker than the pattern
        return None
    text = text.rstrip("\r\n")
    match = _SENTENCE.fullmatch(text)
    if match is None or len(text) > MAX_CHARACTERS or not text.replace("\t", " ").isprintable():
        return None
    kind = match.lastgroup
    if kind is None:
        return EVERYTHING
    scope = match[kind].upper().replace("_", "-")
    if kind == "ARM" and (scope in _RESERVED or _COMMAND.fullmatch(scope)):
        return None  # a reserved word cannot name an arm; a command id as a name would be ambiguous
    return SCOPES.get(scope, scope)

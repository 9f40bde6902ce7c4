"""Recognition of a plain HALT sentence in a microsecond, without the grammar.

A client calls this before it sends: a halt goes to the halt sockets at once and never waits for the parser. The
result must agree with the parser (a test compares them). Only a halt of everything, of an arm or of a command is
recognised here; a halt of another name is sent as an ordinary sentence. What begins with HALT or STOP and is no
sentence ("STOP!", "STOPP", "HALT RIGHT ARM") halts everything: who types it wants no arm to move (decision 0155).
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
_BEGINS = re.compile(r"[ \t,]*(?:HALT|STOP)", re.IGNORECASE | re.ASCII)
_OF_NAME = re.compile(
    rf"[ \t,]*(?:HALT|STOP)[ \t,]+(?:ARM[ \t,]+)?(?P<NAME>{_NAME})[ \t,]*(?:\.[ \t,]*)?(?:--.*)?",
    re.IGNORECASE | re.ASCII,
)
_COMMAND = re.compile(r"C-\d+", re.ASCII)
_RESERVED = reserved_words()


def halt_scope(text: str) -> str | None:
    """The scope of a HALT or STOP sentence: `ALL`, an arm or a command id; `ALL` too for what begins so and is no
    sentence; None for any other text.

    Never raises, for any argument.
    """
    if not isinstance(text, str):
        return None
    begin = text[: MAX_CHARACTERS + len("\r\n")]
    if begin.lstrip(" \t,")[:4].upper() not in _FIRST_WORDS:  # most sentences, and far quicker than the pattern
        return None
    plain = _plain(text)
    return EVERYTHING if plain is None and _BEGINS.match(begin) and not _is_of_name(text) else plain


def named_scope(words: str) -> str:
    """The scope that the words of a caller name, as after HALT in a sentence: ALL, a performer, a command, or another
    name; ALL too for what is none of these."""
    text = f"HALT {words}"
    if scope := halt_scope(text):
        return scope
    named = _OF_NAME.fullmatch(text.rstrip("\r\n"))
    return named["NAME"].upper().replace("_", "-") if named else EVERYTHING


def _plain(text: str) -> str | None:
    text = text[: MAX_CHARACTERS + 3].rstrip("\r\n")
    match = _SENTENCE.fullmatch(text)
    if match is None or not _is_sendable(text):
        return None
    kind = match.lastgroup
    if kind is None:
        return EVERYTHING
    scope = match[kind].upper().replace("_", "-")
    if kind == "ARM" and (scope in _RESERVED or _COMMAND.fullmatch(scope)):
        return None  # a reserved word cannot name an arm; a command id as a name would be ambiguous
    return SCOPES.get(scope, scope)


def _is_of_name(text: str) -> bool:
    """Whether it is a halt of something that has a name, which the broker looks for."""
    match = _OF_NAME.fullmatch(text.rstrip("\r\n"))
    return match is not None and _is_sendable(text) and match["NAME"].upper().replace("_", "-") not in _RESERVED


def _is_sendable(text: str) -> bool:
    return len(text.rstrip("\r\n")) <= MAX_CHARACTERS and text.rstrip("\r\n").replace("\t", " ").isprintable()

"""Is this sentence a plain HALT? Told in a microsecond, without any grammar.

A client asks before it sends: a halt goes to the halt sockets at once and never waits behind a parse. It
must agree with the parser: whatever is a halt here is the same halt there (a test compares them). A halt of
something else than everything, an arm or a command goes the ordinary way.
"""

from __future__ import annotations

import re

from rtc.language.dictionary import reserved_words
from rtc.language.refuse import MAX_CHARACTERS

EVERYTHING = "ALL"
ARMS = {
    "LEFT-ARM": "LEFT-ARM",
    "RIGHT-ARM": "RIGHT-ARM",
    "BOTH-ARMS": EVERYTHING,  # no arm is left, and nothing that wants one may begin
    "LEFT-END-EFF": "LEFT-ARM",
    "RIGHT-END-EFF": "RIGHT-ARM",
}

_NAME = r"[A-Z][A-Z0-9]*(?:[-_][A-Z0-9]+)*"
_SENTENCE = re.compile(
    r"[ \t,]*(?:HALT|STOP)(?:[ \t,]+(?:"
    r"(?P<ALL>ALL)|(?P<HAND>(?:LEFT|RIGHT)[-_](?:ARM|END[-_]EFF)|BOTH[-_]ARMS)|(?P<COMMAND>C[-_]\d+)"
    rf"|ARM[ \t,]+(?P<ARM>{_NAME})))?"
    r"[ \t,]*(?:\.[ \t,]*)?(?:--.*)?",
    re.IGNORECASE | re.ASCII,
)
_COMMAND = re.compile(r"C-\d+", re.ASCII)
_RESERVED = reserved_words()


def halt_scope(text: str) -> str | None:
    """`ALL`, the arm, or the command that a lone HALT or STOP sentence halts; None if it is no such one.

    Never raises, whatever it is given.
    """
    if not isinstance(text, str) or len(text) > MAX_CHARACTERS + len("\r\n"):
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
        return None  # no arm is called so; an arm named like a command would be ambiguous here
    return ARMS.get(scope, scope)

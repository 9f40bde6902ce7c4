"""The lexer: from one line to its words, each with its type and its column in the typed line.

It knows the form of a word, not its place in a sentence. Token patterns and reserved words come from the terminals
of the grammar. This module skips blanks, commas, comments and a final '.'.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

from lark.lexer import PatternStr, TerminalDef, Token

from rtc.language.refuse import MAX_CHARACTERS, SentenceError, quoted, refusal
from rtc.protocol.outcomes import ProgramError, Refusal
from rtc.protocol.spelling import nearest_words
from rtc.protocol.units import UNITS

TOKEN_CLASSES = ("NAME", "STRING", "NUMBER", "QUANTITY")

_UNIT_LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz/%"
_FOREIGN = re.compile(r"(?:(?!--)[!#-+\--~])*[^\x00-\x7f]")  # the rest of a word up to a character outside of ASCII
_MALFORMED_NUMBER = re.compile(r"[-+]?\.?\d[^\s,\"]*")


class Word(Token):
    """A Lark token without line numbers, which halves its cost. A sentence is one line."""

    def __new__(cls, kind: str, value: str, start: int, end: int) -> Word:
        word = str.__new__(cls, value)
        word.type = kind
        word.value = value
        word.start_pos = start
        word.end_pos = end
        return word


class WrittenNumber(NamedTuple):
    """A number as written. `unit` is a key of `UNITS`, or None for a number without a unit."""

    number: float
    unit: str | None
    column: int
    text: str


class Vocabulary:
    """The token patterns of one grammar, compiled once. Raises ProgramError for an incomplete grammar."""

    def __init__(self, terminals: Collection[TerminalDef], reserved: Mapping[str, str]) -> None:
        """`reserved`: terminal -> its word. A terminal that is declared, but not defined, has this spelling alone."""
        shapes = {t.name: t.pattern.to_regexp() for t in terminals}
        missing = [name for name in TOKEN_CLASSES if name not in shapes]
        if missing:
            raise ProgramError(f"the grammar lacks the token class {missing[0]}")
        defined = {t.name: _spelt(t) for t in terminals}
        #: spelling -> (terminal, canonical spelling); synonyms are further spellings
        self.reserved = {
            spelling: (name, word)
            for name, word in reserved.items()
            for spelling in _spellings(name, defined.get(name, word))
        }
        self.scanner = re.compile(
            r"[ \t,]*(?:(?P<NAME>{NAME})|(?P<QUANTITY>{QUANTITY})|(?P<NUMBER>{NUMBER})|(?P<STRING>{STRING})"
            r"|--.*|\.[ \t,]*(?=--|$)|(?P<WRONG>[^ \t,]))".format(**shapes),
            re.IGNORECASE | re.ASCII,
        )

    def words(self, text: str) -> Iterator[Word]:
        """The words from left to right. Raises `SentenceError` at the first character that cannot begin a word."""
        reserved = self.reserved
        plain = text.isascii()
        opening = True  # at the verb: only TEST came before. Here STOP means HALT
        for match in self.scanner.finditer(text):
            kind = match.lastgroup
            if kind is None:  # a comment or the final '.'
                continue
            start, end = match.span(kind)
            value = match[kind]
            if kind == "WRONG":
                raise _malformed(text, start)
            if not plain and (foreign := _FOREIGN.match(text, end)):  # STÖW must not be read as the word ST and a rest
                raise _malformed(text, foreign.end() - 1)
            if kind == "NAME":
                value = value.upper().replace("_", "-")
                kind, value = reserved.get(value, ("NAME", value))
                if opening:
                    if kind == "STOP":
                        kind = value = "HALT"
                    opening = kind == "TEST"
            elif kind != "STRING" and text[end : end + 1] == "," and text[end + 1 : end + 2].isdigit():
                raise _decimal_comma(end)
            yield Word(kind, value, start, end)


def one_line(sentence: str | bytes) -> str | Refusal:
    """The sentence as one line of printable text; a refusal if it is too long, not UTF-8 or not printable."""
    bad_byte = None
    if isinstance(sentence, bytes):
        try:
            text = sentence.decode()
        except UnicodeDecodeError as error:
            text = sentence[: error.start].decode()
            bad_byte = sentence[error.start]
    else:
        text = sentence
    if bad_byte is None:
        text = text.rstrip("\r\n")
    if len(text) > MAX_CHARACTERS:
        limit = f"at most {MAX_CHARACTERS:,} characters"
        return refusal(MAX_CHARACTERS, f"The sentence is too long: it may have {limit}.", [limit])
    if not text.isprintable():
        for column, character in enumerate(text):
            if not character.isprintable() and character != "\t":
                return _invisible(column, character)
    if bad_byte is not None:
        return refusal(len(text), f"The byte 0x{bad_byte:02X} here is not UTF-8 text.", ["readable text in UTF-8"])
    return text


def measured(word: Token) -> WrittenNumber:
    """Reads a number or quantity. Raises `SentenceError` when it is too large for a float."""
    figure = word.value.rstrip(_UNIT_LETTERS)
    unit = word.value[len(figure) :].upper() or None
    number = float(figure)
    column = word.start_pos or 0
    if not math.isfinite(number):
        raise SentenceError(column, f"{quoted(word.value)} is too large a number.", ["a smaller number"])
    return WrittenNumber(number, unit, column, word.value)


def _spelt(terminal: TerminalDef) -> str:
    return terminal.pattern.value if isinstance(terminal.pattern, PatternStr) else terminal.pattern.to_regexp()


def _spellings(name: str, value: str) -> list[str]:
    """The spellings of a reserved word. Lark gives `STOW: "STOW" | "PARK"` as the pattern `(?:STOW|PARK)`."""
    spellings = value.removeprefix("(?:").removesuffix(")").replace("\\", "").split("|")
    for spelling in spellings:
        if not re.fullmatch(r"[A-Z]+(-[A-Z]+)*", spelling):
            raise ProgramError(f"the reserved word {name} is spelt {spelling!r}: capitals and '-' only")
    return spellings


def _invisible(column: int, character: str) -> Refusal:
    if character in "\r\n":
        return refusal(column, "A sentence must be one line; a second line begins here.", ["the end of the sentence"])
    return refusal(column, f"The invisible character U+{ord(character):04X} is not printable text.", ["readable text"])


def _malformed(text: str, column: int) -> SentenceError:
    number = _MALFORMED_NUMBER.match(text, column)
    if number:
        return SentenceError(
            column,
            f"{quoted(number[0])} is neither a number nor a number with a known unit.",
            ["a number", "a quantity such as 10 CM"],
            nearest_words(number[0].upper().lstrip("+-.0123456789"), UNITS),
        )
    if text[column] == '"':
        return SentenceError(column, "The quotation that begins here is not closed.", ['a closing "'])
    meant = " Did you mean -?" if _like_a_dash(text[column]) else ""
    return SentenceError(
        column,
        f"The character {quoted(text[column])} cannot stand here.{meant}",
        ["words of letters, digits and '-'"],
    )


def _decimal_comma(column: int) -> SentenceError:
    """The comma of 60,5: 60.5 in half of the world, and two numbers in a list."""
    return SentenceError(
        column,
        "A comma between two digits can mean one number or two.",
        ["a decimal point for one number, such as 60.5", "a blank after the comma for two, such as 60, 5"],
    )


def _like_a_dash(character: str) -> bool:
    """True for a typographic dash or minus, as web pages and word processors insert."""
    return unicodedata.category(character) == "Pd" or character == "\N{MINUS SIGN}"

"""A grammar, compiled from its text: the vocabulary and the LALR tables that one program of the parser means.

The text is data that may arrive while the system runs, so whatever is wrong with it is a `ProgramError`
that says what. It knows no sentence.
"""

from __future__ import annotations

from types import SimpleNamespace

import lark
from lark.parsers.lalr_interactive_parser import InteractiveParser

from rtc.language.meaning import MEANING
from rtc.language.words import TOKEN_CLASSES, Vocabulary
from rtc.outcomes import ProgramError

START = "sentence"
END = "$END"  # Lark's word for the end of the sentence


class Grammar:
    """Compiled grammar text. Costs a fifth of a second; the caller keeps it. Not changed by parsing."""

    def __init__(self, text: str) -> None:
        if "%import" in text:
            raise ProgramError("the grammar may not import: it is complete in itself")
        try:
            self._lark = lark.Lark(
                text, parser="lalr", lexer="basic", start=START, transformer=SimpleNamespace(**MEANING)
            )
        except lark.exceptions.LarkError as error:
            raise ProgramError(f"the grammar does not compile: {error}") from error
        except RecursionError:
            raise ProgramError("the grammar does not compile: it is nested too deeply") from None
        self.productions: list[tuple[str, tuple[str, ...]]] = []  # in the words of command.bnf
        for rule in self._lark.rules:
            meaning = rule.alias or str(rule.origin.name)
            if meaning not in MEANING:
                raise ProgramError(f"clause {rule.origin.name}: nothing is known of the meaning {meaning!r}")
            self.productions.append((_word(rule.origin.name), tuple(_word(s.name) for s in rule.expansion)))
        self.vocabulary = Vocabulary(self._lark.terminals)
        #: terminal -> the reserved word it stands for
        self.reserved = {t.name: _word(t.name) for t in self._lark.terminals if t.name not in TOKEN_CLASSES}

    def begin(self) -> InteractiveParser:
        """A parser at the beginning of a sentence; it is fed one word at a time."""
        return self._lark.parse_interactive()


def _word(symbol: str) -> str:
    return symbol.replace("_", "-")

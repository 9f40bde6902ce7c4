"""A grammar compiled from its text, the program of the parser: vocabulary and LALR tables.

The text can arrive while the system runs, so each fault in it raises `ProgramError` with the cause. This module
knows no sentence.
"""

from __future__ import annotations

from types import SimpleNamespace

import lark
from lark.parsers.lalr_interactive_parser import InteractiveParser

from rtc.language.meaning import MEANING
from rtc.language.words import TOKEN_CLASSES, Vocabulary
from rtc.protocol.outcomes import ProgramError

START = "sentence"
END = "$END"  # Lark's terminal for the end of the input


class Grammar:
    """Compiled grammar text. Compiling takes 0.2 s, so the caller keeps the object. Parsing does not change it.

    Raises ProgramError.
    """

    def __init__(self, text: str) -> None:
        if "%import" in text:
            raise ProgramError("the grammar must not use %import: it must be one complete text")
        try:
            self._lark = lark.Lark(
                text, parser="lalr", lexer="basic", start=START, transformer=SimpleNamespace(**MEANING)
            )
        except lark.exceptions.LarkError as error:
            raise ProgramError(f"the grammar does not compile: {error}") from error
        except RecursionError:
            raise ProgramError("the grammar does not compile: it is nested too deeply") from None
        self.productions: list[tuple[str, tuple[str, ...]]] = []  # (clause, symbols) of `rtc grammar`
        for rule in self._lark.rules:
            meaning = rule.alias or str(rule.origin.name)
            if meaning not in MEANING:
                raise ProgramError(f"clause {rule.origin.name}: the meaning {meaning!r} does not exist")
            self.productions.append((_word(rule.origin.name), tuple(_word(s.name) for s in rule.expansion)))
        terminals = {s.name for rule in self._lark.rules for s in rule.expansion if s.is_term}
        #: terminal -> the reserved word it stands for
        self.reserved = {name: _word(name) for name in sorted(terminals.difference(TOKEN_CLASSES))}
        self.vocabulary = Vocabulary(self._lark.terminals, self.reserved)

    def begin(self) -> InteractiveParser:
        """A parser at the beginning of a sentence. The caller feeds it one word at a time."""
        return self._lark.parse_interactive()


def _word(symbol: str) -> str:
    return symbol.replace("_", "-")

"""Hands in sentences: the reserved words that name one (`hands.txt`), and how a sentence names an arm.

Every other arm of a cell is named by ARM and its name. BOTH-ARMS names no arm: it is not in the file.
"""

from __future__ import annotations

from importlib import resources

from rtc.protocol.sentence import BOTH_ARMS


def _read() -> dict[str, str]:
    lines = resources.files("rtc.language").joinpath("hands.txt").read_text("utf-8").splitlines()
    return {word: arm for line in lines for word, arm in [line.split()]}


#: reserved word -> the arm that it stands for; the word of an arm stands for itself
ARM_OF_WORD: dict[str, str] = _read()
OWN_WORDS = frozenset({*ARM_OF_WORD.values(), BOTH_ARMS})  # arms that are words of the language


def hand_in_words(arm: str) -> str:
    """An arm as a sentence names it: a name that is not a word of the language follows ARM."""
    return arm if arm in OWN_WORDS or not arm else f"ARM {arm}"

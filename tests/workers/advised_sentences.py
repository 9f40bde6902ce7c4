"""The sentences and clauses in an advice that the grammar does not accept: a person types what is advised."""

from __future__ import annotations

import re
from functools import cache

from rtc.language.dictionary import verbs
from rtc.language.parse import default_grammar, parse
from rtc.protocol.advice import Advice, sentences_of
from rtc.protocol.sentence import ParsedCommand

WORD = r"(?:[A-Z][A-Z0-9]*(?:[-/.][A-Z0-9]+)*|-?\d+(?:\.\d+)?)"
PHRASE = re.compile(rf"(?<![\w-]){WORD}(?: {WORD})+(?![\w-])")
BOUNDS = ("EXCEEDS", "BELOW", "ALONG")  # after TURN: the measure, not the verb
PLACEHOLDERS = {"x y z": "1 2 3", "roll pitch yaw": "0 0 0"}
FORM = re.compile(r" (?:an? (?:distance|amount|time|angle|condition)|without|with)\b")  # of a sentence, not a sentence
#: clause -> a sentence that may have it
CARRIERS = {
    "UNTIL": "LOOSEN BOLT-1",
    "UNLESS": "MOVE RIGHT-ARM BY 5 CM ALONG UP",
    "MAINTAIN": "MOVE RIGHT-ARM BY 5 CM ALONG UP",
    "VIA": "LOCATE MACS-NEW",
    "ASSUMING": "TEST STOW RIGHT-ARM",
}


def wrong(advice: Advice) -> list[str]:
    """The sentences that are none, and what in the words begins as one and is none."""
    bad = [one for one in sentences_of(advice) if not isinstance(parse(default_grammar(), one), ParsedCommand)]
    return [*bad, *(phrase for one in advice for phrase in unparsed(one.words))]


def unparsed(advice: str) -> list[str]:
    """The phrases in capitals that begin as a sentence or a clause, and are none."""
    for words, figures in PLACEHOLDERS.items():
        advice = advice.replace(words, figures)
    phrases = [found for found in PHRASE.finditer(advice) if not FORM.match(advice, found.end())]
    return [found[0] for found in phrases if not _is_sentence(found[0])]


@cache
def _is_sentence(phrase: str) -> bool:
    first = phrase.split()[0]
    if first in CARRIERS:
        phrase = f"{CARRIERS[first]} {phrase}"
    elif first not in verbs() or phrase.split()[1] in BOUNDS:
        return True
    return isinstance(parse(default_grammar(), phrase), ParsedCommand)

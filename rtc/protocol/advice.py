"""What would clear a refusal or a failure: alternatives, each a list of sentences with words for people. Pure data.

Rows of programs have the same form, with placeholders in braces. What a machine needs is in the fields, and no code
takes the words apart. `rtc.wording.advice` makes one text of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import msgspec


class Alternative(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True, gc=False):
    """One way to clear it. Without sentences it is for a person, who does what the words say."""

    sentences: list[str] = []  # complete ones, to be given in this order
    words: str = ""  # beside them: when it applies, or why
    states: list[str] = []  # keys of facts that a person looks at and states with SET: MACS-1.frame
    again: bool = False  # then the refused sentence itself is given again
    instead: bool = False  # they are in the place of the refused sentence, which is not given again


Advice = list[Alternative]
Texts = Mapping[str, str | Sequence[str] | Sequence[Alternative]]

ANOTHER_ARM = Alternative(words="another arm")  # the elaborator states the sentences for arms that are able
NOTHING = Alternative()


def by_person(*words: str) -> Advice:
    """One alternative for each of these words; none for empty ones."""
    return [Alternative(words=one) for one in words if one]


def again_after(words: str) -> Advice:
    """The refused sentence again, after what these words ask a person for."""
    return [Alternative(words=words, again=True)]


def by_sentence(*sentences: str, words: str = "", instead: bool = False) -> Advice:
    """One alternative: these sentences, in order; none if one is empty."""
    return [Alternative(sentences=[*sentences], words=words, instead=instead)] if all(sentences) else []


def sentences_of(advice: Iterable[Alternative]) -> list[str]:
    return [sentence for one in advice for sentence in one.sentences]


def fill_in(advice: Iterable[Alternative], texts: Texts) -> Advice:
    """The advice with its placeholders filled in.

    A list stands for one alternative each: of names that a sentence may have, or of advice that takes the place of a
    sentence. With an empty list the alternative is left out.
    """
    return [done for one in advice for done in _filled(one, texts)]


def _filled(one: Alternative, texts: Texts) -> Advice:
    for name, value in texts.items():
        mark = "{" + name + "}"
        if not isinstance(value, str) and any(mark in sentence for sentence in one.sentences):
            return fill_in([_with(one, mark, each) for each in value], texts)
    plain = {"{" + name + "}": value for name, value in texts.items() if isinstance(value, str)}
    return [
        msgspec.structs.replace(
            one,
            sentences=[_replaced(sentence, plain) for sentence in one.sentences],
            words=_replaced(one.words, plain),
            states=[_replaced(key, plain) for key in one.states],
        )
    ]


def _replaced(text: str, plain: Mapping[str, str]) -> str:
    if "{" in text:
        for mark, value in plain.items():
            text = text.replace(mark, value)
    return text


def _with(one: Alternative, mark: str, part: str | Alternative) -> Alternative:
    if isinstance(part, str):
        return msgspec.structs.replace(one, sentences=[each.replace(mark, part) for each in one.sentences])
    sentences = [own for each in one.sentences for own in (part.sentences if each == mark else [each])]
    return msgspec.structs.replace(
        one,
        sentences=sentences,
        words="; ".join(filter(None, (part.words, one.words))),
        states=[*part.states, *one.states],
        again=one.again or part.again,
        instead=one.instead or part.instead,
    )


def in_order(*steps: Advice) -> Advice:
    """The advice to do all these steps, one after the other: the first alternative of each, then those that differ from
    it in one step."""
    known = [step for n, step in enumerate(steps) if step and step not in steps[:n]]
    if not known:
        return []
    return [joined(*choice) for choice in _choices(known)]


def _choices(steps: Sequence[Advice]) -> Iterator[Advice]:
    first = [step[0] for step in steps]
    yield first
    for n, step in enumerate(steps):
        yield from ([*first[:n], other, *first[n + 1 :]] for other in step[1:])


def joined(*parts: Alternative) -> Alternative:
    """One alternative: all these, one after the other."""
    return Alternative(
        sentences=sentences_of(parts),
        words="; ".join(part.words for part in parts if part.words),
        states=[key for part in parts for key in part.states],
        again=any(part.again for part in parts),
        instead=any(part.instead for part in parts),
    )

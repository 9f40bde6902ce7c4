"""What `rtc do` says about its sentences."""

from __future__ import annotations

import pytest

from rtc.apps.cli.sentences import quotes_forgotten


@pytest.mark.parametrize(
    ("texts", "kinds", "hinted"),
    [
        (["STOW", "RIGHT-ARM"], ["refused", "not_sent"], True),
        (["STOW", "RIGHT-ARM"], ["refused"], True),  # as with --no-wait
        (["HALT", "RIGHT-ARM"], ["succeeded", "refused"], True),
        (["STOW"], ["refused"], False),
        (["STOW LEFT-LEG", "HALT"], ["refused", "not_sent"], False),
        (["HALT", "HALT"], ["succeeded", "succeeded"], False),
    ],
)
def test_single_words_that_are_refused_may_be_a_sentence_without_its_quotes(
    texts: list[str], kinds: list[str], hinted: bool
) -> None:
    hint = quotes_forgotten(texts, [{"text": text, "kind": kind} for text, kind in zip(texts, kinds, strict=False)])

    assert hint.endswith(f'rtc do "{" ".join(texts)}"') if hinted else hint == ""

"""Sentences that are given because their test passed: refused if what the test rests on has changed. Pure."""

from __future__ import annotations

from rtc.protocol import causes
from rtc.protocol.messages import Fact, RestsOn
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.world.model import World

ABSENT = 0  # instead of the version of a fact that does not exist


def refuse_stale(rests_on: RestsOn | None, world: World) -> None:
    """Raise Refused if a fact is not as in the test. Commands of the same test may have changed it."""
    if rests_on is None:
        return
    for key, version in rests_on.relies_on.items():
        fact = world.get(key)
        if (fact.version if fact else ABSENT) != version and not _by_own(fact, rests_on):
            raise _stale(rests_on, key, fact, f"was version {version}" if version else "did not exist")
    for key in rests_on.foreseen:
        if not _by_own(fact := world.get(key), rests_on):
            raise _stale(rests_on, key, fact, "was to be left by a sentence before this one")


def _by_own(fact: Fact | None, rests_on: RestsOn) -> bool:
    return fact is not None and fact.source.partition("/")[0] in rests_on.given


def _stale(rests_on: RestsOn, key: str, fact: Fact | None, was: str) -> Refused:
    now = f"version {fact.version} by {fact.source.partition('/')[0]}" if fact else "not there"
    return Refused.because(
        RefusalReason.STALE,
        f"{key} has changed since the test {rests_on.test}: it {was}, and is {now}",
        where=key,
        clears="test the sentence again: rtc test",
        cause=causes.ChangedSince(test=rests_on.test),
    )

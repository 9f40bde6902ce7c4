"""A world view on paper: predicted facts over real ones, and a record of which real facts were read. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from rtc.protocol.messages import Fact, WorldChange
from rtc.world.model import World

ABSENT = 0  # instead of the version of a fact that does not exist


@dataclass(frozen=True)
class PaperWorld(World):
    """`real`: the facts of the world database; `given`: those that earlier sentences are predicted to leave. `read` has
    the version of each real fact that was read, `foreseen` the given ones. Overlays share them."""

    real: Mapping[str, Fact] = field(default_factory=dict)
    given: Mapping[str, Fact] = field(default_factory=dict)
    read: dict[str, int] = field(default_factory=dict)
    foreseen: dict[str, bool] = field(default_factory=dict)

    def get(self, key: str) -> Fact | None:
        fact = self.facts.get(key)
        if fact is self.real.get(key):
            if not key.startswith("."):  # a question about no object
                self.read[key] = ABSENT if fact is None else fact.version
        elif fact is self.given.get(key):
            self.foreseen[key] = True
        return fact

    def value(self, key: str, default: Any = None) -> Any:
        fact = self.get(key)
        return default if fact is None else fact.value

    def overlay(self, changes: Iterable[WorldChange], source: str = "overlay", at_s: float = 0.0) -> PaperWorld:
        after = super().overlay(changes, source, at_s)
        return replace(self, facts=after.facts)

    def predicted(self) -> list[Fact]:
        """The facts that are not those of the world database, by key: a view states its facts in any order."""
        return [fact for key, fact in sorted(self.facts.items()) if fact is not self.real.get(key)]


def on_paper(world: World, predicted: Iterable[Fact] = ()) -> PaperWorld:
    """A view in which the predicted facts replace the real ones."""
    given = {fact.key: fact for fact in predicted}
    return PaperWorld(world.version, {**world.facts, **given}, world.facts, given)

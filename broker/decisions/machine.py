"""A state machine as a table: (state, stimulus) -> an action and the states that may follow. Pure.

Every machine of the Decision Unit runs from such a table, and `broker.decisions.drawing` draws it for the docs. A table
is complete: each state and stimulus has an action, or a reason why the stimulus changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from enum import StrEnum
from typing import Any, Generic, NamedTuple, TypeVar

from broker.decisions.context import DecisionContext
from broker.decisions.state import State

S = TypeVar("S", bound=StrEnum)
T = TypeVar("T", bound=StrEnum)


class TableCell(NamedTuple, Generic[S]):
    """What one stimulus does in one state."""

    action: Callable[..., None]
    following: frozenset[S]  # the states that may follow; checked after the action


def cell(action: Callable[..., None], *following: S) -> TableCell[S]:
    return TableCell(action, frozenset(following))


class Ignored(NamedTuple, Generic[S, T]):
    """Stimuli that change nothing in these states, and why: late, duplicate, or impossible."""

    states: Iterable[S]
    stimuli: Iterable[T]
    reason: str


class InvalidTransition(AssertionError):
    """A bug: an action led to a state that the table does not allow."""


class Machine(Generic[S, T]):
    """The complete table of one machine. Raises ValueError if a state and stimulus has no cell, or two."""

    def __init__(
        self,
        states: type[S],
        stimuli: type[T],
        rows: dict[S, dict[T, TableCell[S]]],
        ignored: Iterable[Ignored[S, T]],
        *,
        first: S,
        state_of: Callable[[State, str], S],
    ) -> None:
        """`first`: the state of an entity that is not stored yet. `state_of`: the state of an entity by its name."""
        self.states, self.stimuli, self.first, self.state_of = states, stimuli, first, state_of
        self.cells = {(state, stimulus): cell for state, row in rows.items() for stimulus, cell in row.items()}
        self.ignored: dict[tuple[S, T], str] = {}
        for group in ignored:
            for key in ((state, stimulus) for state in group.states for stimulus in group.stimuli):
                if key in self.cells or key in self.ignored:
                    raise ValueError(f"{key} has two entries")
                self.ignored[key] = group.reason
        missing = {(state, stimulus) for state in states for stimulus in stimuli} - {*self.cells, *self.ignored}
        if missing:
            raise ValueError(f"no entry for {sorted(missing)}")

    def run(self, context: DecisionContext, entity: str, stimulus: T, payload: Any = None) -> None:
        """Run the action for this stimulus, and check the state it leads to. `entity`: its name in the state."""
        before = self.state_of(context.state, entity)
        cell = self.cells.get((before, stimulus))
        if cell is None:
            return  # see `ignored`
        cell.action(context, entity, payload)
        after = self.state_of(context.state, entity)
        if after not in cell.following:
            raise InvalidTransition(f"{entity}: {stimulus.value} in {before.value} led to {after.value}")

"""Who holds what, and who is next (R46, R110, A27-A29). Pure; knows names of commands and resources, no more.

A claim is all or nothing: a command holds every name it claims, or stands in line and holds none. So no
command ever waits while holding, and there can be no deadlock. The line is fair: who was given first stands first,
also when it comes back to the line because it needs more than it had, and a claim is granted only when nobody before
it in line wants any of the same names, so nobody starves.

Two modes: exclusive (non-sharable resources, locations that will be written) and shared (locations a plan
relies on). A name may also be in quarantine: its holder has ended, but nobody has confirmed rest.

Thousands may stand in one line. So what is in the way of one is seen without looking at all before it: of a line only
its first matters, and the first in it who wants the name alone.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Collection, Iterable
from typing import NamedTuple

import msgspec

Claim = dict[str, bool]  # name -> exclusive?
WORLD = "the world database"  # in the place of a subsystem


def number(command: str) -> int:
    """17 of "C-17": commands are numbered in order of acceptance."""
    return int(command.rpartition("-")[2])


class Blocked(NamedTuple):
    """The first thing in the way of a claim."""

    name: str
    owner: str


class Quarantine(NamedTuple):
    """Who must confirm rest, and what it may still be executing; or the world, and the command it must be told of."""

    subsystem: str
    primitive: str

    @property
    def in_words(self) -> str:
        if self.subsystem == WORLD:
            return f"{WORLD}, which has not been told yet what {self.primitive} has done"
        return f"{self.subsystem}, which has not confirmed rest"


class Gone(NamedTuple):
    """A claim on a name that is no more; `place` in line is a command's number, 0 of one that was held."""

    name: str
    exclusive: bool
    place: int = 0


class Resources(msgspec.Struct, kw_only=True):
    held: dict[str, Claim] = {}  # command -> what it holds
    waiting: dict[str, Claim] = {}  # command -> what it waits for
    holders: dict[str, Claim] = {}  # name -> {command: exclusive?}: many that share, or one alone
    lines: dict[str, list[str]] = {}  # name -> the commands that wait for it, in order of their numbers
    alone: dict[str, list[str]] = {}  # of each line: those who want the name exclusively
    quarantine: dict[str, Quarantine] = {}  # name -> why it is closed

    def blocker(self, command: str, claim: Claim) -> Blocked | None:
        """The first thing in the way of a claim: held by another, or wanted by one earlier in line.
        What the command holds already is not in its way, or two that extend their claims would send each other back
        to the line for ever."""
        mine = self.held.get(command, {})
        for name, exclusive in claim.items():
            if name in mine and (mine[name] or not exclusive):
                continue
            if name in self.quarantine:
                return Blocked(name, self.quarantine[name].in_words)
            holders = self.holders.get(name, {})
            holder = next((other for other in holders if other != command), None)
            if holder is not None and (exclusive or holders[holder]):
                return Blocked(name, holder)
            line = (self.lines if exclusive else self.alone).get(name)
            if line and number(line[0]) < number(command):
                return Blocked(name, line[0])
        return None

    def take(self, command: str, claim: Claim) -> Blocked | list[str]:
        """Swap what the command holds for this claim. Granted: the list of who else can be granted now, by what it let
        go of. Blocked: what it held before is unchanged."""
        if claim == self.held.get(command):
            return self._grantable(self._leave_line(command))
        blocked = self.blocker(command, claim)
        if blocked is not None:
            return blocked
        gone = [*(gone for gone in self._let_go(command) if not claim.get(gone.name)), *self._leave_line(command)]
        self.held[command] = claim
        for name, exclusive in claim.items():
            self.holders.setdefault(name, {})[command] = exclusive
        return self._grantable(gone)

    def wait(self, command: str, claim: Claim) -> list[str]:
        """Let go of everything and stand in line. Returns who can be granted now."""
        gone = self._let_go(command) + self._leave_line(command)
        self.waiting[command] = claim
        for name, exclusive in claim.items():
            insort(self.lines.setdefault(name, []), command, key=number)
            if exclusive:
                insort(self.alone.setdefault(name, []), command, key=number)
        return self._grantable(gone)

    def release(
        self, command: str, in_doubt: Quarantine | None = None, names: frozenset[str] = frozenset()
    ) -> list[str]:
        """The command is over; returns who can be granted now, in order. When it is `in_doubt` whether its primitive
        has come to rest, those of `names` that it held stay closed until that is confirmed."""
        let_go = self._let_go(command)
        if in_doubt:
            self.quarantine.update((gone.name, in_doubt) for gone in let_go if gone.name in names)
        return self._grantable(let_go + self._leave_line(command))

    def confirm_rest(self, subsystem: str, names: Collection[str] | None = None, moved: str = "") -> list[str]:
        """Open what waited for this subsystem: all, or only these names and what was closed for the sake of `moved`, a
        primitive or all of a command's; returns who can be granted now."""
        freed = [
            name
            for name, by in self.quarantine.items()
            if by.subsystem == subsystem
            and (names is None or name in names or f"{by.primitive}.".startswith(f"{moved}."))
        ]
        for name in freed:
            del self.quarantine[name]
        return self._grantable(Gone(name, exclusive=True) for name in freed)

    def _grantable(self, gone: Iterable[Gone]) -> list[str]:
        """Of those for whom one of these was in the way, whoever has nothing else in the way.
        Each must still be granted by `take`, which may refuse the second of two that want the same."""
        found: dict[str, None] = {}
        for claim in gone:
            if claim.name not in self.lines:  # most of the time
                continue
            for command in self._behind(claim):
                wanted = self.waiting[command]
                if command not in found and self._is_first(command, wanted) and self.blocker(command, wanted) is None:
                    found[command] = None
        return list(found)

    def _is_first(self, command: str, claim: Claim) -> bool:
        """In line for all that it wants alone. The cheap question comes first: thousands may share a name."""
        return all(self.lines[name][0] == command for name, exclusive in claim.items() if exclusive)

    def _behind(self, gone: Gone) -> list[str]:
        """Those in line for whom a claim that is gone may have been all that was in the way. One that shared was in the
        way of an exclusive one that is first, at most; an exclusive one of those behind it, to the next like it."""
        line = self.lines[gone.name]
        if not gone.exclusive:
            return line[:1]
        alone = self.alone.get(gone.name)
        end = bisect_left(line, number(alone[0]), key=number) + 1 if alone else len(line)
        return line[bisect_left(line, gone.place, key=number) : end]

    def _let_go(self, command: str) -> list[Gone]:
        claim = self.held.pop(command, None)
        if not claim:
            return []
        for name in claim:
            del self.holders[name][command]
            if not self.holders[name]:
                del self.holders[name]
        return [Gone(name, exclusive) for name, exclusive in claim.items()]

    def _leave_line(self, command: str) -> list[Gone]:
        claim = self.waiting.pop(command, None)
        if claim is None:  # most of the time
            return []
        place = number(command)
        for name, exclusive in claim.items():
            for lines in (self.lines, self.alone) if exclusive else (self.lines,):
                line = lines[name]
                del line[bisect_left(line, place, key=number)]
                if not line:
                    del lines[name]
        return [Gone(name, exclusive, place) for name, exclusive in claim.items()]

"""Who holds what, and who is next (R46, R110, A27-A29). Pure; knows names of commands and resources, no more.

A claim is all or nothing: a command holds every name it claims, or stands in line and holds none. So no
command ever waits while holding, and there can be no deadlock. The line is fair: who was given first stands first,
also when it comes back to the line because it needs more than it had, and a claim is granted only when nobody before
it in line wants any of the same names, so nobody starves.

Two modes: exclusive (non-sharable resources, locations that will be written) and shared (locations a plan
relies on). A name may also be in quarantine: its holder has ended, but nobody has confirmed rest.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import NamedTuple

import msgspec

Claim = dict[str, bool]  # name -> exclusive?


def number(command: str) -> int:
    """17 of "C-17": commands are numbered in order of acceptance."""
    return int(command.rpartition("-")[2])


class Blocked(NamedTuple):
    """The first thing in the way of a claim."""

    name: str
    owner: str


class Quarantine(NamedTuple):
    """Who must confirm rest, and what it may still be executing."""

    subsystem: str
    primitive: str


class Resources(msgspec.Struct, kw_only=True):
    held: dict[str, Claim] = {}  # command -> what it holds
    waiting: dict[str, Claim] = {}  # command -> what it waits for
    holders: dict[str, Claim] = {}  # name -> {command: exclusive?}
    lines: dict[str, Claim] = {}  # name -> {command: exclusive?}, in order of their numbers
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
                return Blocked(name, f"{self.quarantine[name].subsystem}, which has not confirmed rest")
            for holder, theirs in self.holders.get(name, {}).items():
                if holder != command and (exclusive or theirs):
                    return Blocked(name, holder)
            for earlier, theirs in self.lines.get(name, {}).items():
                if number(earlier) >= number(command):
                    break
                if exclusive or theirs:
                    return Blocked(name, earlier)
        return None

    def take(self, command: str, claim: Claim) -> Blocked | list[str]:
        """Swap what the command holds for this claim. Granted: the list of who else can be granted now, by what it let
        go of. Blocked: what it held before is unchanged."""
        if claim == self.held.get(command):
            return self._grantable(self._leave_line(command))
        blocked = self.blocker(command, claim)
        if blocked is not None:
            return blocked
        freed = [name for name in self._let_go(command) if not claim.get(name)] + self._leave_line(command)
        self.held[command] = claim
        for name, exclusive in claim.items():
            self.holders.setdefault(name, {})[command] = exclusive
        return self._grantable(freed)

    def wait(self, command: str, claim: Claim) -> list[str]:
        """Let go of everything and stand in line. Returns who can be granted now."""
        freed = self._let_go(command) + self._leave_line(command)
        self.waiting[command] = claim
        for name, exclusive in claim.items():
            line = self.lines.setdefault(name, {})
            behind = line and number(next(reversed(line))) < number(command)
            line[command] = exclusive
            if not behind:
                self.lines[name] = dict(sorted(line.items(), key=lambda waiting: number(waiting[0])))
        return self._grantable(freed)

    def release(
        self, command: str, in_doubt: Quarantine | None = None, names: frozenset[str] = frozenset()
    ) -> list[str]:
        """The command is over; returns who can be granted now, in order. When it is `in_doubt` whether its primitive
        has come to rest, those of `names` that it held stay closed until that is confirmed."""
        freed = self._let_go(command) + self._leave_line(command)
        if in_doubt:
            self.quarantine.update((name, in_doubt) for name in freed if name in names)
        return self._grantable(freed)

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
        return self._grantable(freed)

    def _grantable(self, freed: Iterable[str]) -> list[str]:
        """The first in each line that has moved (and those who share with the first), if nothing else blocks them.
        Each must still be granted by `take`, which may refuse the second of two that want the same."""
        found: dict[str, None] = {}
        for name in freed:
            for command, exclusive in self.lines.get(name, {}).items():
                if command not in found and self.blocker(command, self.waiting[command]) is None:
                    found[command] = None
                if exclusive:
                    break
        return list(found)

    def _let_go(self, command: str) -> list[str]:
        return self._forget(self.held, self.holders, command)

    def _leave_line(self, command: str) -> list[str]:
        return self._forget(self.waiting, self.lines, command)

    @staticmethod
    def _forget(claims: dict[str, Claim], index: dict[str, Claim], command: str) -> list[str]:
        if command not in claims:
            return []
        names = list(claims.pop(command))
        for name in names:
            del index[name][command]
            if not index[name]:
                del index[name]
        return names

"""Resource allocation: claims, waiting lines and quarantine (R46, R110, A27-A29).

Pure: it knows the names of commands and resources only. A claim is all or nothing: a command holds every name it
claims, or waits in line and holds none. A command never waits in line while holding, so a deadlock is impossible. (A
wait for space keeps its claims, see `broker.decisions.command.space`.) The lines are ordered by command number, also
for a command that returns with a larger claim. A claim is granted only if no earlier command in line wants one of its
names, so starvation is impossible.

A claim on a name is exclusive (non-sharable resources, locations that will be written) or shared (locations a plan
relies on). A name in quarantine is closed: its holder has ended, but its subsystem has not confirmed rest.

A line may hold thousands of commands. The search for a blocker therefore looks at two entries of a line only: the
first one, and the first one with an exclusive claim.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Collection, Iterable
from typing import NamedTuple

import msgspec

Claim = dict[str, bool]  # name -> exclusive?
WORLD = "the world database"  # stands for a subsystem in a quarantine


def number(command: str) -> int:
    """17 of "C-17": commands are numbered in order of acceptance."""
    return int(command.rpartition("-")[2])


class Blocked(NamedTuple):
    """The first obstacle of a claim: the name, and the command or quarantine that blocks it."""

    name: str
    owner: str


class Quarantine(NamedTuple):
    """Why a name is closed: the subsystem that must confirm rest and its primitive, or WORLD and an ended command."""

    subsystem: str
    primitive: str

    @property
    def in_words(self) -> str:
        if self.subsystem == WORLD:
            return f"{WORLD}, which does not have the changes of {self.primitive} yet"
        return f"{self.subsystem}, which has not confirmed rest"


class RemovedClaim(NamedTuple):
    """A claim on a name that was removed. `place`: the command's number if it waited, 0 if it held the name."""

    name: str
    exclusive: bool
    place: int = 0


class Resources(msgspec.Struct, kw_only=True):
    held: dict[str, Claim] = {}  # command -> what it holds
    waiting: dict[str, Claim] = {}  # command -> what it waits for
    holders: dict[str, Claim] = {}  # name -> {command: exclusive?}: many that share, or one alone
    lines: dict[str, list[str]] = {}  # name -> the commands that wait for it, in order of their numbers
    alone: dict[str, list[str]] = {}  # name -> the commands of its line with an exclusive claim
    quarantine: dict[str, Quarantine] = {}  # name -> why it is closed

    def blocker(self, command: str, claim: Claim) -> Blocked | None:
        """The first obstacle of a claim: a name held by another command, or wanted by an earlier one in line.

        Names that the command already holds are not obstacles. Otherwise two commands that extend their claims would
        send each other back to the line without end."""
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
        """Replace the command's held claim by this one. Returns the commands that can be granted now, or Blocked; then
        the held claim is unchanged."""
        if claim == self.held.get(command):
            return self._grantable(self._leave_line(command)) if self.lines else []
        blocked = self.blocker(command, claim)
        if blocked is not None:
            return blocked
        before = self._let_go(command)
        self.held[command] = claim
        for name, exclusive in claim.items():
            self.holders.setdefault(name, {})[command] = exclusive
        if not self.lines:  # the usual case: no command waits
            return []
        gone = [gone for gone in _removed(before) if not claim.get(gone.name)]
        return self._grantable(gone + self._leave_line(command))

    def wait(self, command: str, claim: Claim) -> list[str]:
        """Release everything and wait in line. Returns the commands that can be granted now."""
        gone = _removed(self._let_go(command)) + self._leave_line(command)
        self.waiting[command] = claim
        for name, exclusive in claim.items():
            insort(self.lines.setdefault(name, []), command, key=number)
            if exclusive:
                insort(self.alone.setdefault(name, []), command, key=number)
        return self._grantable(gone)

    def release(self, command: str, in_doubt: Quarantine | None = None, names: Collection[str] = ()) -> list[str]:
        """Release the claims of an ended command. Returns the commands that can be granted now, in order.

        `in_doubt`: the rest of its primitive is not confirmed; its held `names` are quarantined until it is."""
        let_go = self._let_go(command)
        if in_doubt:
            self.quarantine.update((name, in_doubt) for name in let_go if name in names)
        if not self.lines:  # the usual case: no command waits
            return []
        return self._grantable(_removed(let_go) + self._leave_line(command))

    def confirm_rest(self, subsystem: str, names: Collection[str] | None = None, moved: str = "") -> list[str]:
        """Lift the quarantines of this subsystem. Returns the commands that can be granted now.

        `names`: only these, None = all. `moved`: also those of this primitive, or of all primitives of a command."""
        freed = [
            name
            for name, by in self.quarantine.items()
            if by.subsystem == subsystem
            and (names is None or name in names or f"{by.primitive}.".startswith(f"{moved}."))
        ]
        for name in freed:
            del self.quarantine[name]
        return self._grantable(RemovedClaim(name, exclusive=True) for name in freed)

    def _grantable(self, gone: Iterable[RemovedClaim]) -> list[str]:
        """The waiting commands that were blocked by a removed claim and have no other obstacle.

        The caller must still call `take` for each; it may refuse the second of two with the same names."""
        found: dict[str, None] = {}
        for claim in gone:
            if claim.name not in self.lines:  # the usual case
                continue
            for command in self._waiting_for(claim):
                wanted = self.waiting[command]
                if command not in found and self._is_first(command, wanted) and self.blocker(command, wanted) is None:
                    found[command] = None
        return list(found)

    def _is_first(self, command: str, claim: Claim) -> bool:
        """True if it is first in line for all its exclusive names. This cheap check precedes `blocker`."""
        return all(self.lines[name][0] == command for name, exclusive in claim.items() if exclusive)

    def _waiting_for(self, gone: RemovedClaim) -> list[str]:
        """The waiting commands that a removed claim may have blocked.

        A removed shared claim can unblock only the first waiter. A removed exclusive claim can unblock the waiters
        behind it, up to the next exclusive one."""
        line = self.lines[gone.name]
        if not gone.exclusive:
            return line[:1]
        alone = self.alone.get(gone.name)
        end = bisect_left(line, number(alone[0]), key=number) + 1 if alone else len(line)
        return line[bisect_left(line, gone.place, key=number) : end]

    def _let_go(self, command: str) -> Claim:
        """Remove what the command holds, and return it."""
        claim = self.held.pop(command, {})
        for name in claim:
            holders = self.holders[name]
            del holders[command]
            if not holders:
                del self.holders[name]
        return claim

    def _leave_line(self, command: str) -> list[RemovedClaim]:
        claim = self.waiting.pop(command, None)
        if claim is None:  # the usual case
            return []
        place = number(command)
        for name, exclusive in claim.items():
            for lines in (self.lines, self.alone) if exclusive else (self.lines,):
                line = lines[name]
                del line[bisect_left(line, place, key=number)]
                if not line:
                    del lines[name]
        return [RemovedClaim(name, exclusive, place) for name, exclusive in claim.items()]


def _removed(claim: Claim) -> list[RemovedClaim]:
    return [RemovedClaim(name, exclusive) for name, exclusive in claim.items()]

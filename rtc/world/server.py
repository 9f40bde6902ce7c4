"""The server of the world database: from request to answer, over a `Store`. Sockets are in `__main__`.

A read returns many facts, optionally only those newer than a version. A commit is written only under a lease of this
cluster's broker, and only in the leased locations. Its values must be valid, and each job writes once.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import msgspec

from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.world import lease as leases
from rtc.world.model import MOVED, location, moved_with, problem, selected
from rtc.world.store import Store

Answer = m.View | m.Committed | m.WorldRefused
Request = m.ReadView | m.Commit | m.WorldHistory | m.Doubt


class Server:
    """Answers requests. The caller must call `store.save()` before it sends the answers."""

    def __init__(
        self,
        store: Store,
        key: bytes,
        fixed: Callable[[], Collection[str]] = tuple,
        motions: Callable[[], Collection[str]] = tuple,
    ) -> None:
        """`fixed` returns the names of objects that no motion can change, `motions` those of the arms in motion."""
        self.store = store
        self._fixed = fixed
        self._key = key
        self._motions = motions

    def answer(self, request: Request, at_s: float) -> Answer:
        match request:
            case m.ReadView():
                return self._view(request)
            case m.Commit():
                return self._commit(request, at_s)
            case m.WorldHistory():
                facts = self.store.history(request.key, request.limit)
                return m.View(request=request.request, version=self.store.version, facts=facts)
            case m.Doubt():
                return self._doubt(request, at_s)

    def _view(self, request: m.ReadView) -> m.View:
        version = self.store.version
        if request.since == version:
            return m.View(request=request.request, version=version, facts=[], changing=self._changing())
        since = request.since if request.since < version else 0  # a later version than ours: from another database
        facts = selected(self.store.facts, request.keys, since)
        return m.View(request=request.request, version=version, facts=facts, changing=self._changing())

    def _changing(self) -> list[str]:
        moving = self._motions()
        return list(moved_with(self.store.facts, moving)) if moving else []

    def _commit(self, request: m.Commit, at_s: float) -> m.Committed | m.WorldRefused:
        if refusal := self._refusal_of(request):
            return m.WorldRefused(request=request.request, refusal=refusal)
        job = request.lease.job
        before = self.store.committed(job)
        if before is not None:
            return m.Committed(request=request.request, version=before)
        version = self.store.write(job, request.changes, request.source, at_s)
        return m.Committed(request=request.request, version=version)

    def _doubt(self, request: m.Doubt, at_s: float) -> m.Committed | m.WorldRefused:
        lease = request.lease
        if not leases.check(self._key, lease):
            refusal = _not_allowed("the lease was not signed by this cluster's broker", lease.job)
            return m.WorldRefused(request=request.request, refusal=refusal)
        before = self.store.committed(lease.job)
        if before is None:
            of = None if lease.job.startswith(leases.DOUBT) else lease.locations
            before = make_suspect(self.store, lease.job, request.why, self._fixed(), at_s, of)
        return m.Committed(request=request.request, version=before)

    def _refusal_of(self, request: m.Commit) -> Refusal | None:
        lease = request.lease
        if not leases.check(self._key, lease):
            return _not_allowed("the lease was not signed by this cluster's broker", lease.job)
        for change in request.changes:
            if location(change.key) not in lease.locations:
                allowed = ", ".join(lease.locations) or "nothing"
                return _not_allowed(
                    f"{change.key} is outside the lease of {lease.job}, which is for {allowed}", change.key
                )
            if wrong := problem(change):
                return _not_allowed(wrong, change.key)
        return None


def make_suspect(
    store: Store, job: str, why: str, fixed: Collection[str], at_s: float, locations: Collection[str] | None = None
) -> int:
    """Make the facts that a motion changes suspect, with `why` as their source; returns the new version.

    `locations`: only their facts, and those of what arms among them hold; None = all."""
    if locations is not None:
        held = (store.facts.get(f"{name}.holding") for name in locations)
        locations = {*locations, *(fact.value for fact in held if fact is not None and isinstance(fact.value, str))}
    moved = (
        key
        for key in store.facts
        if key.rpartition(".")[2] in MOVED
        and location(key) not in fixed
        and (locations is None or location(key) in locations)
    )
    changes = [m.WorldChange(key=key, keep_value=True, validity=m.Validity.SUSPECT) for key in moved]
    return store.write(job, changes, source=why, at_s=at_s)


class PackedView(m.Message, frozen=True, kw_only=True, tag="View"):
    """A View with encoded facts."""

    request: str
    version: int
    facts: msgspec.Raw
    changing: list[str] = msgspec.field(default_factory=list)


class Packer:
    """Encodes views. It encodes each fact only once, and the same facts in a row as a whole, because reads are far more
    frequent than writes."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[m.Fact, msgspec.Raw]] = {}
        self._latest: list[m.Fact] = []
        self._packed = wire.raw([])

    def pack(self, answer: Answer) -> Any:
        """The answer, with encoded facts if it is a View. The encoding of the whole is the same."""
        if not isinstance(answer, m.View):
            return answer
        if answer.facts != self._latest:  # costs little if they are the same objects
            self._latest = answer.facts
            self._packed = wire.raw([self._fact(fact) for fact in answer.facts])
        return PackedView(request=answer.request, version=answer.version, facts=self._packed, changing=answer.changing)

    def _fact(self, fact: m.Fact) -> msgspec.Raw:
        known = self._known.get(fact.key)
        if known is not None and known[0] is fact:
            return known[1]
        packed = wire.raw(fact)
        self._known[fact.key] = (fact, packed)
        return packed


def _not_allowed(message: str, where: str) -> Refusal:
    return Refusal(reason=RefusalReason.NOT_ALLOWED, message=message, where=where)

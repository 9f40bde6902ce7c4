"""Records of the peers on other machines: connected from where, joined, lost and refused, for `rtc status`.

Pure: the time is an argument. A record is kept per key and host, and for some time after the last event.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

import msgspec

from rtc.protocol.messages import PeerRow, RemoteWorker
from rtc.runtime.keys import KnownKey

KEPT_S = 1800.0  # a record without a connection is dropped after this time
RECORDS = 200  # maximum number of records; the one without an event for longest is dropped
LOST_KEPT = 64  # maximum number of lost workers per record
WORDS = 160  # characters of a refusal


class OpenConnection(NamedTuple):
    """One connection of a peer. `worker`: its state if the peer is a worker."""

    key: str
    host: str
    worker: RemoteWorker | None = None


class Record(msgspec.Struct):
    """Events of one key on one host."""

    last_message_at_s: float = 0.0
    refused: int = 0
    refusal: str = ""
    refused_at_s: float = 0.0
    lost: dict[str, float] = {}  # worker -> time

    @property
    def latest_s(self) -> float:
        return max(self.last_message_at_s, self.refused_at_s, *self.lost.values())


class PeerRecords:
    """`_records`: (name of the key, host) -> record; an unknown key has an empty name."""

    def __init__(self) -> None:
        self._records: dict[tuple[str, str], Record] = {}

    def received(self, key: str, host: str, now: float) -> None:
        """A message of this peer has arrived."""
        self._record(key, host, now).last_message_at_s = now

    def refuse(self, key: str, host: str, words: str, now: float) -> None:
        """A handshake or a message of this peer was refused."""
        record = self._record(key, host, now)
        record.refused += 1
        record.refusal, record.refused_at_s = words[:WORDS], now

    def join(self, key: str, host: str, worker: str, now: float) -> None:
        """A worker is connected; on whichever host it was lost before, it is not lost any more."""
        self._record(key, host, now)
        for (name, _), record in self._records.items():
            if name == key:
                record.lost.pop(worker, None)

    def lose(self, key: str, host: str, worker: str, now: float) -> None:
        """The connection of a worker is lost."""
        lost = self._record(key, host, now).lost
        lost[worker] = now
        if len(lost) > LOST_KEPT:
            del lost[min(lost, key=lambda name: lost[name])]

    def _record(self, key: str, host: str, now: float) -> Record:
        record = self._records.get((key, host))
        if record is None:
            if len(self._records) >= RECORDS:
                del self._records[min(self._records, key=lambda peer: self._records[peer].latest_s)]
            record = self._records[key, host] = Record(last_message_at_s=0.0)
        return record

    def rows(
        self,
        known: Mapping[str, KnownKey],
        revoked: Mapping[str, KnownKey],
        open_: Iterable[OpenConnection],
        now: float,
    ) -> list[PeerRow]:
        """One row per key and host, and one for each known key that was not used. `known`, `revoked`: keys by name."""
        connections: dict[tuple[str, str], list[OpenConnection]] = {}
        for one in open_:
            connections.setdefault((one.key, one.host), []).append(one)
        self._forget(connections, now)
        used = {key for key, _ in (*self._records, *connections)}
        peers = sorted({*self._records, *connections, *((key, "") for key in known if key not in used)})
        return [self._row(peer, known, revoked, connections.get(peer, ())) for peer in peers]

    def _row(
        self,
        peer: tuple[str, str],
        known: Mapping[str, KnownKey],
        revoked: Mapping[str, KnownKey],
        connections: Collection[OpenConnection],
    ) -> PeerRow:
        (name, host), record = peer, self._records.get(peer, Record())
        key = known.get(name) or revoked.get(name)
        return PeerRow(
            key=name,
            role=key.role if key else "",
            host=host,
            asked=known[name].count if name in known else 0,
            revoked=name in revoked and name not in known,
            workers=sorted((c.worker for c in connections if c.worker is not None), key=lambda worker: worker.name),
            lost=dict(record.lost),
            connections=len(connections),
            last_message_at_s=record.last_message_at_s,
            refused=record.refused,
            refusal=record.refusal,
            refused_at_s=record.refused_at_s,
        )

    def _forget(self, connected: Collection[tuple[str, str]], now: float) -> None:
        for peer in [peer for peer, record in self._records.items() if now - record.latest_s > KEPT_S]:
            if peer not in connected:
                del self._records[peer]

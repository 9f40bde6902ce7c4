"""Records of peers on other machines: who joined, who is lost, who was refused; bounded, and kept for some time."""

from __future__ import annotations

from broker.gateway.peers import KEPT_S, LOST_KEPT, RECORDS, OpenConnection, PeerRecords
from rtc.protocol.messages import PeerRow, RemoteWorker
from rtc.protocol.roles import Role
from rtc.runtime.keys import KnownKey

W1 = KnownKey(name="w1", role=Role.WORKER, public="p1", made_at=1.0, count=2)
EYES = KnownKey(name="eyes", role=Role.OBSERVER, public="p2", made_at=1.0)
KNOWN = {"w1": W1, "eyes": EYES}
BINDER = RemoteWorker(name="binder@18", last_message_at_s=10.0)


def rows(records: PeerRecords, *connected: OpenConnection, now: float = 10.0) -> dict[tuple[str, str], PeerRow]:
    return {(row.key, row.host): row for row in records.rows(KNOWN, {}, connected, now)}


def test_a_known_key_has_a_row_before_its_first_use() -> None:
    found = rows(PeerRecords())
    assert [(row.key, row.role, row.asked, row.connections) for row in found.values()] == [
        ("eyes", Role.OBSERVER, 0, 0),
        ("w1", Role.WORKER, 2, 0),
    ]


def test_each_host_of_a_key_has_its_row() -> None:
    records = PeerRecords()
    records.received("w1", "10.0.0.1", 9.0)
    records.received("w1", "10.0.0.2", 8.0)
    found = rows(records, OpenConnection("w1", "10.0.0.1", BINDER))

    assert found["w1", "10.0.0.1"].workers == [BINDER]
    assert found["w1", "10.0.0.2"].last_message_at_s == 8.0
    assert ("w1", "") not in found


def test_a_lost_worker_stays_until_it_is_back_on_any_host() -> None:
    records = PeerRecords()
    records.join("w1", "10.0.0.1", "binder@18", 1.0)
    records.lose("w1", "10.0.0.1", "binder@18", 5.0)
    assert rows(records)["w1", "10.0.0.1"].lost == {"binder@18": 5.0}

    records.join("w1", "10.0.0.2", "binder@18", 6.0)
    assert rows(records)["w1", "10.0.0.1"].lost == {}


def test_refusals_are_counted_by_key_and_host_with_the_latest_reason() -> None:
    records = PeerRecords()
    records.refuse("w1", "10.0.0.1", "the key is revoked", 3.0)
    records.refuse("w1", "10.0.0.1", "no such node", 4.0)
    records.refuse("", "10.0.0.9", "the key is not known here", 5.0)
    found = rows(records)

    assert (found["w1", "10.0.0.1"].refused, found["w1", "10.0.0.1"].refusal) == (2, "no such node")
    assert found["w1", "10.0.0.1"].refused_at_s == 4.0
    assert (found["", "10.0.0.9"].role, found["", "10.0.0.9"].refused) == ("", 1)


def test_a_revoked_key_is_marked_and_no_worker_is_asked_for_with_it() -> None:
    records = PeerRecords()
    records.refuse("w1", "10.0.0.1", "the key is revoked", 3.0)
    (row,) = records.rows({}, {"w1": W1}, [], 10.0)
    assert (row.revoked, row.role, row.asked) == (True, Role.WORKER, 0)


def test_a_record_is_kept_for_some_time_and_longer_while_it_is_connected() -> None:
    records = PeerRecords()
    records.refuse("", "10.0.0.9", "the key is not known here", 5.0)
    records.received("w1", "10.0.0.1", 5.0)
    alive = OpenConnection("w1", "10.0.0.1", BINDER)

    assert ("", "10.0.0.9") in rows(records, alive, now=5.0 + 0.9 * KEPT_S)
    found = rows(records, alive, now=5.0 + 1.1 * KEPT_S)
    assert ("", "10.0.0.9") not in found
    assert found["w1", "10.0.0.1"].last_message_at_s == 5.0


def test_strangers_from_everywhere_do_not_fill_the_memory_nor_displace_an_active_peer() -> None:
    records = PeerRecords()
    for n in range(3 * RECORDS):
        records.received("w1", "10.0.0.1", float(n))
        records.refuse("", f"host-{n}", "the key is not known here", float(n))
    found = rows(records, now=3.0 * RECORDS)

    assert len(found) <= RECORDS + len(KNOWN)
    assert found["w1", "10.0.0.1"].last_message_at_s == 3 * RECORDS - 1
    for n in range(2 * LOST_KEPT):
        records.lose("w1", "10.0.0.1", f"binder@{n}", float(n))
    assert list(rows(records, now=3.0 * RECORDS)["w1", "10.0.0.1"].lost) == [
        f"binder@{n}" for n in range(LOST_KEPT, 2 * LOST_KEPT)
    ]

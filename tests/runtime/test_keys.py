"""Keys on disk: made once, for their owner alone, found, revoked; and the refusal of a wrong file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import zmq
from zmq.utils.monitor import recv_monitor_message

from rtc.protocol.outcomes import KeyTrouble
from rtc.protocol.roles import TCP_ENDPOINTS, Role
from rtc.runtime.keys import (
    PEERS_OF_KEY,
    REVOKED_KEPT,
    KeyFile,
    KeyPair,
    KeyRing,
    _forbidden,
    check_address,
    endpoint_address,
    is_everywhere,
    secure_server,
)

AT = "tcp://lab:5555"


@pytest.fixture
def ring(tmp_path: Path) -> KeyRing:
    return KeyRing(tmp_path / "run")


def test_a_new_key_is_known_by_its_public_half_and_whole_in_one_file(ring: KeyRing, tmp_path: Path) -> None:
    made = ring.new("alice", Role.OPERATOR, AT, tmp_path / "alice.key")

    assert KeyFile.load(tmp_path / "alice.key") == made
    (tmp_path / "alice.key").chmod(0o644)
    with pytest.raises(KeyTrouble, match=r"others may read or change .* \(mode 644\); .* chmod 600 "):
        KeyFile.load(tmp_path / "alice.key")
    assert [(known.name, known.role, known.public) for known in ring.known()] == [("alice", Role.OPERATOR, made.public)]
    assert made.cluster == ring.cluster().public
    kept = "".join(path.read_text() for path in ring.path.iterdir())
    assert made.secret not in kept


def test_all_files_are_their_owners_alone(ring: KeyRing, tmp_path: Path) -> None:
    ring.new("alice", Role.OPERATOR, AT, tmp_path / "alice.key")

    files = [tmp_path / "alice.key", *ring.path.iterdir()]
    assert {path.stat().st_mode & 0o777 for path in files} == {0o600}
    assert ring.path.stat().st_mode & 0o777 == 0o700


def test_the_cluster_keeps_its_own_key(ring: KeyRing) -> None:
    assert ring.cluster() == KeyRing(ring.path.parent).cluster()


def test_a_revoked_key_is_not_known_and_its_name_is_free(ring: KeyRing, tmp_path: Path) -> None:
    first = ring.new("alice", Role.OPERATOR, AT, tmp_path / "1.key")
    ring.revoke("alice")
    assert ring.known() == []
    second = ring.new("alice", Role.OBSERVER, AT, tmp_path / "2.key")

    assert [known.public for known in ring.known()] == [second.public] != [first.public]


def test_a_revoked_key_stays_in_the_records_with_its_time(ring: KeyRing, tmp_path: Path) -> None:
    first = ring.new("w1", Role.WORKER, AT, tmp_path / "1.key", count=8)
    assert [key.count for key in ring.known()] == [8]
    ring.revoke("w1")
    second = ring.new("w1", Role.WORKER, AT, tmp_path / "2.key")
    ring.revoke("w1")

    assert [(key.name, key.public) for key in ring.revoked()] == [("w1", first.public), ("w1", second.public)]
    assert all(key.revoked_at >= key.made_at for key in ring.revoked())
    with pytest.raises(KeyTrouble, match=r"there is no key 'w1' \(revoked "):
        ring.revoke("w1")


def test_the_records_of_revoked_keys_are_limited_to_the_latest(ring: KeyRing, tmp_path: Path) -> None:
    for n in range(REVOKED_KEPT + 2):
        ring.new(f"w{n}", Role.WORKER, AT, tmp_path / f"{n}.key")
        ring.revoke(f"w{n}")

    assert [key.name for key in ring.revoked()] == [f"w{n}" for n in range(2, REVOKED_KEPT + 2)]


@pytest.mark.parametrize(
    ("role", "count", "advice"),
    [(Role.OPERATOR, 1, "leave out --count"), (Role.WORKER, PEERS_OF_KEY + 1, "one key per host")],
)
def test_a_count_that_could_not_be_reached_is_refused(
    ring: KeyRing, tmp_path: Path, role: Role, count: int, advice: str
) -> None:
    with pytest.raises(KeyTrouble, match=advice):
        ring.new("w1", role, AT, tmp_path / "w1.key", count=count)
    assert ring.known() == []
    assert not (tmp_path / "w1.key").exists()


def test_nothing_that_is_there_is_written_over(ring: KeyRing, tmp_path: Path) -> None:
    ring.new("alice", Role.OPERATOR, AT, tmp_path / "alice.key")
    before = (tmp_path / "alice.key").read_bytes()

    with pytest.raises(KeyTrouble, match="rtc keys revoke alice"):
        ring.new("alice", Role.OBSERVER, AT, tmp_path / "other.key")
    with pytest.raises(KeyTrouble, match="--out"):
        ring.new("bob", Role.OBSERVER, AT, tmp_path / "alice.key")
    assert (tmp_path / "alice.key").read_bytes() == before
    assert [known.name for known in ring.known()] == ["alice"]
    assert not (tmp_path / "other.key").exists()


@pytest.mark.parametrize("name", ["", "../x", "a/b", "a b", ".x", "é", "x" * 33, "a\n"])
def test_a_name_that_could_be_mistaken_is_none(ring: KeyRing, tmp_path: Path, name: str) -> None:
    with pytest.raises(KeyTrouble, match="not a name for a key"):
        ring.new(name, Role.OBSERVER, AT, tmp_path / "x.key")


@pytest.mark.parametrize(
    "address",
    [
        *("", "lab:5555", "tcp://lab", "tcp://:5555", "tcp://lab:0", "tcp://lab:x", "tcp://lab:99999"),
        *("tcp://lab:65530", "tcp://lab:5555/x", "ipc:///tmp/x", "tcp://a@lab:5555"),
    ],
)
def test_an_invalid_address_is_refused_with_an_example(address: str) -> None:
    with pytest.raises(KeyTrouble, match=r"tcp://|too high"):
        check_address(address)


def test_each_endpoint_has_its_port() -> None:
    ports = [endpoint_address("tcp://[::1]:5555", endpoint).rpartition(":")[2] for endpoint in TCP_ENDPOINTS]
    assert ports == [str(5555 + n) for n in range(len(TCP_ENDPOINTS))]
    assert endpoint_address("tcp://*:5555", "front") == "tcp://*:5555"


@pytest.mark.parametrize("address", ["tcp://*:1", "tcp://0.0.0.0:1", "tcp://[::]:1"])
def test_everywhere_is_no_address_for_others(address: str) -> None:
    assert is_everywhere(address)


def test_a_key_has_no_way_where_its_role_has_no_business(ring: KeyRing, tmp_path: Path) -> None:
    key = ring.new("w1", Role.WORKER, AT, tmp_path / "w1.key")
    assert key.endpoint("workers").startswith("tcp://lab:")
    for endpoint in ("front", "halt", "bench", "supervisor"):
        with pytest.raises(KeyTrouble, match="role worker"):
            key.endpoint(endpoint)


@pytest.mark.parametrize(
    "change",
    [{"secret": "x" * 40}, {"public": "short"}, {"cluster": "é"}, {"role": "king"}, {"address": "lab"}, {"name": None}],
)
def test_a_damaged_file_is_distinguished(ring: KeyRing, tmp_path: Path, change: dict[str, object]) -> None:
    path = tmp_path / "alice.key"
    ring.new("alice", Role.OPERATOR, AT, path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(KeyTrouble):
        KeyFile.load(path)


@pytest.mark.parametrize("body", [b"", b"\xff\xfe", b"[]", b"{}", b"x" * 10_000])
def test_a_file_that_is_not_a_key_file_is_refused(tmp_path: Path, body: bytes) -> None:
    path = tmp_path / "x.key"
    path.write_bytes(body)
    with pytest.raises(KeyTrouble, match="not a key file"):
        KeyFile.load(path)
    with pytest.raises(KeyTrouble, match="there is no key file"):
        KeyFile.load(tmp_path)


def test_a_damaged_file_in_the_ring_gives_no_access(ring: KeyRing, tmp_path: Path) -> None:
    ring.new("alice", Role.OPERATOR, AT, tmp_path / "alice.key")
    (ring.path / "bob.known").write_bytes((ring.path / "alice.known").read_bytes())  # a name that is not its own
    (ring.path / "eve.known").write_bytes(b"nonsense")
    assert [known.name for known in ring.known()] == ["alice"]


@pytest.mark.slow
@pytest.mark.untimed
def test_without_a_handler_of_handshakes_every_key_is_refused() -> None:
    """libzmq would otherwise accept any key, between the bind of an endpoint and the start of the handler."""
    public, secret = zmq.curve_keypair()
    with zmq.Context() as context, context.socket(zmq.ROUTER) as server, context.socket(zmq.DEALER) as peer:
        server.linger = peer.linger = 0
        secure_server(server, KeyPair(public=public.decode(), secret=secret.decode()), "front", "tcp://127.0.0.1:*")
        server.bind("tcp://127.0.0.1:*")
        peer.curve_serverkey = public
        peer.curve_publickey, peer.curve_secretkey = zmq.curve_keypair()
        events = peer.get_monitor_socket()
        peer.connect(server.last_endpoint)
        seen = set()
        while not seen & ENDS:
            assert events.poll(10_000), "no handshake ended"
            seen.add(recv_monitor_message(events)["event"])
        peer.disable_monitor()
    assert zmq.EVENT_HANDSHAKE_SUCCEEDED not in seen


ENDS = {
    zmq.EVENT_HANDSHAKE_SUCCEEDED,
    zmq.EVENT_HANDSHAKE_FAILED_AUTH,
    zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL,
    zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL,
    zmq.EVENT_DISCONNECTED,
}


def test_a_secret_of_an_engine_may_be_read_by_the_group_alone():
    """systemd and Kubernetes hand over files of root with the mode 0440; a file of one's own needs no group."""
    assert not 0o440 & _forbidden(owner=0, user=1000)
    assert 0o444 & _forbidden(owner=0, user=1000)
    assert 0o460 & _forbidden(owner=0, user=1000)
    assert 0o440 & _forbidden(owner=1000, user=1000)
    assert 0o440 & _forbidden(owner=0, user=0)

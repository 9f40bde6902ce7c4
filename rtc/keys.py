"""Keys for a cluster that is reached over tcp: made, listed, revoked on its own machine; used on another one.

    RUN_DIR/keys/cluster.secret   the cluster's own pair (0600)
    RUN_DIR/keys/NAME.known       one known key: name, role, public half. No secret: nobody can take it from here
    NAME.key                      the one file (0600) for the other machine: all it needs to come in

The directory outlives the run. A key is known as long as its file is there: the gate looks several times a second.
Keys are CURVE25519 pairs, Z85 text of 40 characters. Knows no socket but the one it is asked to secure.
"""

from __future__ import annotations

import os
import re
import time
from pathlib import Path
from typing import Any, Protocol, TypeVar
from urllib.parse import urlsplit

import msgspec
import zmq

from rtc.outcomes import ClusterError, KeyTrouble
from rtc.roles import MAY, TCP_DOORS, Role
from rtc.settings import KEYS

CLUSTER, KNOWN = "cluster.secret", ".known"
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,31}", re.ASCII)
BYTES = 4096  # of a key file; ours have some hundred
HANDSHAKE_MS = 5_000  # patience for one
# So that a line that is cut without a word is noticed: by the kernel, because libzmq 4.3.5 aborts the process when its
# own heartbeat is due on a line that has failed while its reader was behind (zeromq/libzmq issue 4364).
KEEPALIVE_IDLE_S, KEEPALIVE_EVERY_S, KEEPALIVES, UNHEARD_MS = 2, 1, 4, 6_000

Document = TypeVar("Document")


class Doors(Protocol):
    """Where a cluster's sockets are and how one is secured before it connects: `Settings`, or a `KeyFile`."""

    def endpoint(self, name: str) -> str: ...

    def secure(self, socket: zmq.Socket[Any]) -> None: ...

    @property
    def far(self) -> bool: ...


class Pair(msgspec.Struct, frozen=True, kw_only=True):
    public: str
    secret: str


class KnownKey(msgspec.Struct, frozen=True, kw_only=True):
    name: str
    role: Role
    public: str
    made_at: float  # seconds since 1970


class KeyFile(msgspec.Struct, frozen=True, kw_only=True):
    """All that another machine needs to reach the cluster. Checked when loaded."""

    name: str
    role: Role
    address: str  # tcp://HOST:PORT of the first door
    cluster: str  # the cluster's public key: nobody else can pass for it
    public: str
    secret: str

    @property
    def far(self) -> bool:
        return True

    def endpoint(self, name: str) -> str:
        """The address of a door. Raises KeyTrouble for one that this key has nothing to do at."""
        if self.role not in MAY.get(name, {}):
            raise KeyTrouble(f"{self.name} is a key for the role {self.role}, which has no way to {name!r} over tcp")
        return door_address(self.address, name)

    def secure(self, socket: zmq.Socket[Any]) -> None:
        """Before it connects: nothing leaves in the clear, and nothing is taken from anybody but this cluster."""
        socket.curve_serverkey = self.cluster.encode()
        socket.curve_publickey = self.public.encode()
        socket.curve_secretkey = self.secret.encode()
        watch_line(socket)
        _allow_ipv6(socket, self.address)

    @staticmethod
    def load(path: str | Path) -> KeyFile:
        """Raises KeyTrouble that says what is wrong with the file."""
        if not Path(path).is_file():
            raise KeyTrouble(f"there is no key file {path}; one is made where the cluster is: rtc keys new")
        key = _read(Path(path), KeyFile)
        if (mode := Path(path).stat().st_mode & 0o777) & 0o077:
            raise KeyTrouble(f"others may read or change {path} (mode {mode:o}); not used until: chmod 600 {path}")
        check_address(key.address)
        try:
            sound = zmq.curve_public(key.secret.encode()) == key.public.encode() and len(key.cluster) == 40
        except (zmq.ZMQError, ValueError):
            sound = False
        if not sound:
            raise KeyTrouble(f"{path} is damaged: its keys do not belong together; make a new one: rtc keys new")
        return key


class KeyRing:
    """The keys of one cluster, on its own machine. Raises KeyTrouble."""

    def __init__(self, run_dir: str | Path) -> None:
        self.path = Path(run_dir) / KEYS

    def cluster(self) -> Pair:
        """The cluster's own pair, made when it is asked for first."""
        path = self.path / CLUSTER
        if not path.exists():
            self.path.mkdir(mode=0o700, parents=True, exist_ok=True)
            _write(path, _new_pair())
        return _read(path, Pair)

    def new(self, name: str, role: Role, address: str, out: Path) -> KeyFile:
        """Make a key: known here from now on, and whole in `out`. An existing file is not touched."""
        if not NAME.fullmatch(name):
            raise KeyTrouble(f"{name!r:.80} is no name for a key: a letter, then letters, digits, - and _; 32 at most")
        check_address(address)
        pair = _new_pair()
        known = KnownKey(name=name, role=role, public=pair.public, made_at=time.time())
        key = KeyFile(
            name=name,
            role=role,
            address=address,
            cluster=self.cluster().public,
            public=pair.public,
            secret=pair.secret,
        )
        where = self.path / f"{name}{KNOWN}"
        if where.exists():
            raise KeyTrouble(f"there is a key {name} already; choose another name, or first: rtc keys revoke {name}")
        _write(out, key)  # first: what cannot be handed over need not be known
        try:
            _write(where, known)
        except BaseException:
            out.unlink()
            raise
        return key

    def revoke(self, name: str) -> KnownKey:
        """Forget a key. Raises KeyTrouble when there is none of that name."""
        for known in self.known():
            if known.name == name:
                (self.path / f"{name}{KNOWN}").unlink(missing_ok=True)
                return known
        names = ", ".join(known.name for known in self.known()) or "none"
        raise KeyTrouble(f"there is no key {name!r:.80}; known are: {names}")

    def known(self) -> list[KnownKey]:
        """By name. A file that cannot be read is no key: nobody comes in by it."""
        found = []
        for path in sorted(self.path.glob(f"*{KNOWN}")):
            try:
                key = _read(path, KnownKey)
            except KeyTrouble:
                continue
            if key.name == path.name.removesuffix(KNOWN):
                found.append(key)
        return found


def check_address(address: str) -> str:
    """The address as it was given. Raises KeyTrouble when it is no tcp://HOST:PORT with room for all doors above it."""
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or not port or address != f"tcp://{parts.netloc}" or "@" in address:
        raise KeyTrouble(f"{address!r:.80} is no address: tcp://HOST:PORT is, as tcp://192.168.1.5:5555")
    if port + len(TCP_DOORS) - 1 > 65535:
        raise KeyTrouble(f"port {port} leaves no room for {len(TCP_DOORS)} ports, one above the other")
    return address


def is_everywhere(address: str) -> bool:
    """Whether a cluster listens there on all of its machine's addresses: none that others could connect to."""
    return urlsplit(address).hostname in ("*", "0.0.0.0", "::")


def door_address(address: str, door: str) -> str:
    parts = urlsplit(address)
    host = parts.netloc.rpartition(":")[0]
    return f"tcp://{host}:{(parts.port or 0) + TCP_DOORS.index(door)}"


def secure_server(socket: zmq.Socket[Any], pair: Pair, door: str, address: str) -> None:
    """Before it is bound. The ZAP handler hears the door's name as the domain."""
    socket.curve_server = True
    socket.curve_secretkey = pair.secret.encode()
    socket.zap_domain = door.encode()
    watch_line(socket)
    _allow_ipv6(socket, address)


def watch_line(socket: zmq.Socket[Any]) -> None:
    socket.setsockopt(zmq.TCP_KEEPALIVE, 1)
    socket.setsockopt(zmq.TCP_KEEPALIVE_IDLE, KEEPALIVE_IDLE_S)
    socket.setsockopt(zmq.TCP_KEEPALIVE_INTVL, KEEPALIVE_EVERY_S)
    socket.setsockopt(zmq.TCP_KEEPALIVE_CNT, KEEPALIVES)
    socket.setsockopt(zmq.TCP_MAXRT, UNHEARD_MS)
    socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)


def _allow_ipv6(socket: zmq.Socket[Any], address: str) -> None:
    if "[" in address:
        socket.setsockopt(zmq.IPV6, 1)


def _new_pair() -> Pair:
    try:
        public, secret = zmq.curve_keypair()
    except zmq.ZMQError:
        raise ClusterError("this libzmq was built without CURVE: no cluster can be reached over tcp with it") from None
    return Pair(public=public.decode(), secret=secret.decode())


def _read(path: Path, kind: type[Document]) -> Document:
    try:
        with open(path, "rb") as file:
            return msgspec.json.decode(file.read(BYTES), type=kind)
    except OSError as error:
        raise KeyTrouble(f"cannot read {path}: {error.strerror}") from None
    except (msgspec.MsgspecError, UnicodeDecodeError, ValueError) as error:
        raise KeyTrouble(f"{path} is no key file: {error}") from None


def _write(path: Path, document: object) -> None:
    """For its owner alone, whole or not at all as others see it; never over something that is there."""
    body = msgspec.json.format(msgspec.json.encode(document)) + b"\n"
    aside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with open(os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as file:
            file.write(body)
        os.link(aside, path)  # unlike a rename it fails when there is one
    except FileExistsError:
        raise KeyTrouble(f"{path} is there already; choose another file with --out") from None
    except OSError as error:
        raise KeyTrouble(f"cannot write {path}: {error.strerror}") from None
    finally:
        aside.unlink(missing_ok=True)

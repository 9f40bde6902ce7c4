"""CURVE keys for access to a cluster over tcp: made, listed and revoked on its machine, used on another one.

    RUN_DIR/keys/cluster.secret   the cluster's own key pair (0600)
    RUN_DIR/keys/NAME.known       one known key: name, role, public half; it holds no secret
    RUN_DIR/keys/NAME-N.revoked   a record of a revoked key, for lists and messages only
    NAME.key                      key file (0600) for the other machine: all that it needs to connect

The directory outlives the run. A key is valid while its `.known` file exists: the gateway checks several times a
second. Keys are CURVE25519 pairs, each half as Z85 text of 40 characters.
"""

from __future__ import annotations

import contextlib
import os
import re
import time
from pathlib import Path
from typing import Any, Protocol, TypeVar
from urllib.parse import urlsplit

import msgspec
import zmq

from rtc.protocol.outcomes import ClusterError, KeyTrouble
from rtc.protocol.roles import MAY, TCP_ENDPOINTS, Role
from rtc.protocol.spelling import unknown
from rtc.runtime.settings import KEYS

CLUSTER, KNOWN, REVOKED = "cluster.secret", ".known", ".revoked"
REVOKED_KEPT = 100  # maximum number of records of revoked keys; the oldest go first
PEERS_OF_KEY = 32  # maximum number of connections of one key per endpoint
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,31}", re.ASCII)
BYTES = 4096  # maximum size of a key file; a real one has some hundred
HANDSHAKE_MS = 30_000  # time limit of a handshake: four round trips, also over a link of several seconds
CONNECT_MS = 2_000  # time limit of an attempt to connect; the kernel alone would wait for minutes on a cut link
# The declared limit until a cut link is noticed. The kernel closes a connection whose peer has acknowledged nothing for
# UNACKNOWLEDGED_MS (TCP_USER_TIMEOUT), counted from the first repetition of a packet. It checks idle connections every
# KEEPALIVE_S. ZeroMQ's own heartbeat is not used: libzmq 4.3.5 aborts the process if it is due on a failed connection
# while the reader is behind (zeromq/libzmq issue 4364).
LINK_LIMIT_S = 5.0
UNACKNOWLEDGED_MS, KEEPALIVE_S, KEEPALIVES = 2_500, 1, 2

Document = TypeVar("Document")


class Endpoints(Protocol):
    """Addresses of a cluster's sockets and how to secure one before it connects: `Settings`, or a `KeyFile`."""

    def endpoint(self, name: str) -> str: ...

    def addresses(self, name: str) -> dict[str, str]: ...

    def secure(self, socket: zmq.Socket[Any]) -> None: ...

    @property
    def far(self) -> bool: ...


class KeyPair(msgspec.Struct, frozen=True, kw_only=True):
    """A CURVE key pair (Z85 text)."""

    public: str
    secret: str


class KnownKey(msgspec.Struct, frozen=True, kw_only=True):
    """The cluster's record of a key that it accepts."""

    name: str
    role: Role
    public: str
    made_at: float  # seconds since 1970
    count: int = 0  # number of workers that are to use this key; 0 = not stated
    revoked_at: float = 0.0  # seconds since 1970; 0 = not revoked


class KeyFile(msgspec.Struct, frozen=True, kw_only=True):
    """All that another machine needs to reach the cluster. Checked when loaded."""

    name: str
    role: Role
    address: str  # tcp://HOST:PORT of the first endpoint
    cluster: str  # the cluster's public key, which authenticates it
    public: str
    secret: str

    @property
    def far(self) -> bool:
        return True

    def endpoint(self, name: str) -> str:
        """The address of an endpoint. Raises KeyTrouble if the role of this key has no access to it."""
        if self.role not in MAY.get(name, {}):
            may = ", ".join(role for role in Role if role in MAY.get(name, {})) or "none"
            raise KeyTrouble(
                f"{self.name} is a key for the role {self.role}, which has no access to {name!r} over tcp; "
                f"these roles have: {may}"
            )
        return endpoint_address(self.address, name)

    def addresses(self, name: str) -> dict[str, str]:
        """As `Settings.addresses`; over tcp only the first subsystem of arms is reached without the broker."""
        return {"": self.endpoint(name)}

    def secure(self, socket: zmq.Socket[Any]) -> None:
        """Set up encryption and authentication of this cluster; call it before `connect`."""
        socket.curve_serverkey = self.cluster.encode()
        socket.curve_publickey = self.public.encode()
        socket.curve_secretkey = self.secret.encode()
        watch_line(socket)
        _allow_ipv6(socket, self.address)

    @staticmethod
    def load(path: str | Path) -> KeyFile:
        """Read and check a key file. Raises KeyTrouble with the reason."""
        if not Path(path).is_file():
            raise KeyTrouble(f"there is no key file {path}; one is made where the cluster is: rtc keys new")
        key = _read(Path(path), KeyFile)
        status = Path(path).stat()
        if (mode := status.st_mode & 0o777) & _forbidden(status.st_uid, os.geteuid()):
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
    """The keys of one cluster, on its own machine. Every method may raise KeyTrouble."""

    def __init__(self, run_dir: str | Path) -> None:
        self.path = Path(run_dir) / KEYS

    def cluster(self) -> KeyPair:
        """The cluster's own pair; the first call makes it."""
        path = self.path / CLUSTER
        if not path.exists():
            self.path.mkdir(mode=0o700, parents=True, exist_ok=True)
            _write(path, _new_pair())
        return _read(path, KeyPair)

    def new(self, name: str, role: Role, address: str, out: Path, count: int = 0) -> KeyFile:
        """Make a key: its public half becomes known here, the whole goes to `out`. Never replaces a file.

        `count`: number of workers that are to use it; `rtc status` compares it with those that have joined.
        """
        if not NAME.fullmatch(name):
            raise KeyTrouble(
                f"{name!r:.80} is not a name for a key: a letter, then letters, digits, - and _; at most 32"
            )
        check_address(address)
        _check_count(role, count)
        pair = _new_pair()
        known = KnownKey(name=name, role=role, public=pair.public, made_at=time.time(), count=count)
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
        _write(out, key)  # first: a key that cannot be handed over must not become known
        try:
            _write(where, known)
        except BaseException:
            out.unlink()
            raise
        return key

    def revoke(self, name: str) -> KnownKey:
        """Forget a key, permanently: also a restarted gateway does not admit it. Raises KeyTrouble when there is none
        of that name."""
        for known in self.known():
            if known.name == name:
                (self.path / f"{name}{KNOWN}").unlink(missing_ok=True)
                _sync(self.path)
                self._record(msgspec.structs.replace(known, revoked_at=time.time()))
                return known
        before = [key for key in self.revoked() if key.name == name]
        when = f" (revoked {_date(before[-1].revoked_at)})" if before else ""
        raise KeyTrouble(unknown("key", f"{name!r:.80}{when}", (key.name for key in self.known())))

    def _record(self, key: KnownKey) -> None:
        """Record a revoked key. A full disk does not matter: the key is revoked without this record."""
        with contextlib.suppress(KeyTrouble, OSError):
            _write(self.path / f"{key.name}-{time.time_ns()}{REVOKED}", key)
            for path in sorted(self.path.glob(f"*{REVOKED}"), key=_number)[:-REVOKED_KEPT]:
                path.unlink(missing_ok=True)

    def revoked(self) -> list[KnownKey]:
        """The latest revoked keys, the oldest first."""
        found = []
        for path in self.path.glob(f"*{REVOKED}"):
            with contextlib.suppress(KeyTrouble):
                found.append(_read(path, KnownKey))
        return sorted(found, key=lambda key: key.revoked_at)

    def known(self) -> list[KnownKey]:
        """All known keys, sorted by name. An unreadable file is skipped: it gives no access."""
        found = []
        for path in sorted(self.path.glob(f"*{KNOWN}")):
            try:
                key = _read(path, KnownKey)
            except KeyTrouble:
                continue
            if key.name == path.name.removesuffix(KNOWN):
                found.append(key)
        return found


def _check_count(role: Role, count: int) -> None:
    if count and role is not Role.WORKER:
        raise KeyTrouble(f"a count of workers is for keys of the role worker, not {role}; leave out --count")
    if not 0 <= count <= PEERS_OF_KEY:
        raise KeyTrouble(f"a key serves 1 to {PEERS_OF_KEY} workers, not {count}; make one key per host or group")


def check_address(address: str) -> str:
    """The address, checked. Raises KeyTrouble if it is not tcp://HOST:PORT with enough ports above PORT."""
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or not port or address != f"tcp://{parts.netloc}" or "@" in address:
        raise KeyTrouble(
            f"{address!r:.80} is not an address; write tcp://HOST:PORT, for example tcp://192.168.1.5:5555"
        )
    if port + len(TCP_ENDPOINTS) - 1 > 65535:
        raise KeyTrouble(f"port {port} is too high: the cluster needs {len(TCP_ENDPOINTS)} consecutive ports")
    return address


def is_everywhere(address: str) -> bool:
    """True for a wildcard address: a cluster can listen on it, but nothing can connect to it."""
    return urlsplit(address).hostname in ("*", "0.0.0.0", "::")


def endpoint_address(address: str, endpoint: str) -> str:
    """tcp address of one endpoint: the n-th has the port n above that of `address`."""
    parts = urlsplit(address)
    host = parts.netloc.rpartition(":")[0]
    return f"tcp://{host}:{(parts.port or 0) + TCP_ENDPOINTS.index(endpoint)}"


def secure_server(socket: zmq.Socket[Any], pair: KeyPair, endpoint: str, address: str) -> None:
    """Set up a listening socket; call it before `bind`. The ZAP handler receives the endpoint's name as domain."""
    socket.curve_server = True
    socket.curve_secretkey = pair.secret.encode()
    socket.zap_domain = endpoint.encode()
    socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)  # without a handler, refuse; libzmq would accept any key
    watch_line(socket)
    _allow_ipv6(socket, address)


def watch_line(socket: zmq.Socket[Any]) -> None:
    """Let the kernel detect a cut link within LINK_LIMIT_S."""
    socket.setsockopt(zmq.TCP_KEEPALIVE, 1)
    socket.setsockopt(zmq.TCP_KEEPALIVE_IDLE, KEEPALIVE_S)
    socket.setsockopt(zmq.TCP_KEEPALIVE_INTVL, KEEPALIVE_S)
    socket.setsockopt(zmq.TCP_KEEPALIVE_CNT, KEEPALIVES)
    socket.setsockopt(zmq.TCP_MAXRT, UNACKNOWLEDGED_MS)
    socket.setsockopt(zmq.CONNECT_TIMEOUT, CONNECT_MS)
    socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)


def _forbidden(owner: int, user: int) -> int:
    """Bits that the mode of a key file must not have.

    The group of another user may read a file of root: so systemd and Kubernetes hand over a secret."""
    return 0o037 if owner == 0 and user != 0 else 0o077


def _allow_ipv6(socket: zmq.Socket[Any], address: str) -> None:
    if "[" in address:
        socket.setsockopt(zmq.IPV6, 1)


def _number(path: Path) -> int:
    """The time in the name of a record, which orders the records."""
    text = path.name.removesuffix(REVOKED).rpartition("-")[2]
    return int(text) if text.isdigit() else 0


def _date(at: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M", time.localtime(at))


def _sync(folder: Path) -> None:
    """Let a change of the directory survive a loss of power."""
    with contextlib.suppress(OSError):
        fd = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)


def _new_pair() -> KeyPair:
    try:
        public, secret = zmq.curve_keypair()
    except zmq.ZMQError:
        raise ClusterError("this libzmq was built without CURVE, which clusters need over tcp") from None
    return KeyPair(public=public.decode(), secret=secret.decode())


def _read(path: Path, kind: type[Document]) -> Document:
    try:
        with open(path, "rb") as file:
            return msgspec.json.decode(file.read(BYTES), type=kind)
    except OSError as error:
        raise KeyTrouble(f"cannot read {path}: {error.strerror}") from None
    except (msgspec.MsgspecError, UnicodeDecodeError, ValueError) as error:
        raise KeyTrouble(f"{path} is not a key file: {error}") from None


def _write(path: Path, document: object) -> None:
    """Write a file of mode 0600 atomically. Raises KeyTrouble if `path` exists."""
    body = msgspec.json.format(msgspec.json.encode(document)) + b"\n"
    aside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with open(os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as file:
            file.write(body)
        os.link(aside, path)  # unlike a rename, a link fails if the file exists
    except FileExistsError:
        raise KeyTrouble(f"{path} exists already; choose another file with --out") from None
    except OSError as error:
        raise KeyTrouble(f"cannot write {path}: {error.strerror}") from None
    finally:
        aside.unlink(missing_ok=True)

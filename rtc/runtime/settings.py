"""Settings of one cluster, its endpoints and its run directory.

`main` of each process reads the settings once and passes them down.
"""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, get_args

import msgspec
from msgspec import Meta

from rtc.protocol.outcomes import ClusterError
from rtc.protocol.subsystems import DEFAULTS, Subsystem
from rtc.runtime import environment

SUN_PATH_LIMIT = 107  # bytes of a Unix socket's path on Linux
MIN_DIM, MAX_DIM = 2, 8  # limits of the cube's dimension; a smaller cube lacks kinds of workers
MAX_WORKERS = 64  # maximum number of workers of a kind
MAX_REMOTE_WORKERS = 1_000  # maximum number of workers of a kind on other machines
Mcm = Literal["bullet", "kinematic"]
MCMS: tuple[str, ...] = get_args(Mcm)


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """The configuration of one cluster. The supervisor writes it to `settings.json` in the run directory.

    `rtc up` makes it from its options; the limits of values are checked when it is decoded.
    """

    run_dir: str
    run: str = ""  # identifies this run; data of an earlier run in the directory are not continued
    cell: str = "swapout"  # name of a cell, or a file
    subsystems: tuple[Subsystem, ...] = DEFAULTS  # those of the cell
    dim: Annotated[int, Meta(ge=MIN_DIM, le=MAX_DIM)] = 2  # dimension of the cube: 2^dim workers
    # Workers of each kind when idle; None = as many as the cube has.
    least_workers: Annotated[int, Meta(ge=0, le=MAX_WORKERS)] | None = None
    most_workers: Annotated[int, Meta(ge=1, le=MAX_WORKERS)] = 4  # of each kind, when jobs wait
    mcm: Mcm = "bullet"
    speed: Annotated[float, Meta(ge=0)] = 1.0  # simulated seconds per second; 0 = as fast as possible
    listen: str = ""  # tcp://HOST:PORT of the gateway for other machines; empty = no gateway
    more: str = ""  # command line that starts {count} workers of a {kind} on other machines; empty = none
    # Workers of each kind on other machines that the supervisor asks for.
    scale_out_max: Annotated[int, Meta(ge=1, le=MAX_REMOTE_WORKERS)] = 8
    scale_out_timeout_s: Annotated[float, Meta(gt=0)] = 60.0  # time for them to join; then they are asked for again
    record: str = ""  # directory for the files of the recorder; empty = no recorder

    far = False  # the cluster is on this machine and shares its clock

    @property
    def path(self) -> Path:
        return Path(self.run_dir)

    @property
    def least(self) -> int:
        """Minimum number of workers of each kind."""
        return 1 << (self.dim - 2) if self.least_workers is None else self.least_workers

    @property
    def most(self) -> int:
        """Number of workers of a kind up to which this machine starts more."""
        return max(self.least, self.most_workers, 1)

    @property
    def first_remote_node(self) -> int:
        """The lowest address of workers on other machines; those of this machine are below it."""
        return max(1 << self.dim, (1 << MIN_DIM) * self.most)

    @property
    def timeout_scale(self) -> float:
        """Seconds of ours per simulated second, at least 1: the factor of limits on our clock for motions."""
        return 1.0 / self.speed if 0.0 < self.speed < 1.0 else 1.0

    def endpoint(self, name: str, subsystem: str = "") -> str:
        """The ZeroMQ address of one of the cluster's sockets; `name` is a key of ENDPOINTS.

        `subsystem`: the one of `with_estop` that binds it, for those of OF_SUBSYSTEMS; empty: the first."""
        assert name in ENDPOINTS, name
        number = self.with_estop.index(subsystem) if subsystem else 0
        file = ENDPOINTS[name] if number == 0 else ENDPOINTS[name].replace(".", f"-{number + 1}.")
        return f"ipc://{self.path / file}"

    def addresses(self, name: str) -> dict[str, str]:
        """The address of a socket at each subsystem that binds it; of those of OF_SUBSYSTEMS more than one."""
        return {one: self.endpoint(name, one) for one in (self.with_estop if name in OF_SUBSYSTEMS else [""])}

    @property
    def with_estop(self) -> list[str]:
        """The subsystems that bind a socket for halts of their own."""
        return [one.name for one in self.subsystems if one.estop]

    def secure(self, socket: object) -> None:
        """Does nothing: the mode of the run directory (0700) protects its sockets."""

    def save(self) -> None:
        """Write `settings.json` in one step: a client of a cluster that comes up sees all of it, or nothing.

        Raises OSError."""
        aside = self.path / f"{SETTINGS}.new"
        aside.write_bytes(msgspec.json.format(msgspec.json.encode(self)))
        os.replace(aside, self.path / SETTINGS)

    @staticmethod
    def load(run_dir: str | Path) -> Settings:
        """The settings of the cluster in `run_dir`. Raises FileNotFoundError if there is none."""
        return msgspec.json.decode((Path(run_dir) / SETTINGS).read_bytes(), type=Settings)


# In the run directory:
SETTINGS = "settings.json"  # stays after the end of the cluster
LAST_WORDS = "ended.txt"  # in a run directory: commands and arms that were stopped at the end of the cluster
LOCK = "supervisor.lock"  # locked while the supervisor lives; the kernel releases it when the process ends
KEYS = "keys"  # a directory: keys of other machines
# socket -> file in the run directory; comment: process that binds it, kind, peers
ENDPOINTS: dict[str, str] = {
    "front": "front.sock",  # broker ROUTER: clients
    "halt": "halt.sock",  # broker ROUTER: halts and nothing else
    "workers": "workers.sock",  # broker ROUTER
    "subsystems": "subsystems.sock",  # broker ROUTER
    "supervisor": "supervisor.sock",  # broker ROUTER: the supervisor
    "events": "events.sock",  # broker PUB: ProgressNote, CommandEnded
    "world": "world.sock",  # world database ROUTER
    "estop": "estop.sock",  # subsystem ROUTER: halts and nothing else
    "telemetry": "telemetry.sock",  # subsystem PUB
    "operate": "operate.sock",  # subsystem ROUTER: twists of operators
    "bench": "bench.sock",  # subsystem ROUTER: truth and belief errors, simulators only
}


#: Sockets that every subsystem of arms binds for itself.
OF_SUBSYSTEMS = ("estop", "telemetry", "operate", "bench")
#: Sockets where an identity in use is protected: a second connection with the same identity is ignored.
NO_HANDOVER = ("front", "halt", "estop", "operate")


class SocketBounds(NamedTuple):
    """Limits per peer of a socket, so that no peer fills the owner's memory."""

    frame: int  # bytes (MAXMSGSIZE); ZeroMQ disconnects a peer that sends a larger frame
    unread: int  # messages from it (receive high-water mark); further sends block at the peer
    unsent: int  # messages to it (send high-water mark); further messages are dropped


KIB = 1 << 10
BOUNDS: dict[str, SocketBounds] = {
    "front": SocketBounds(256 * KIB, 256, 10_000),  # frame: a program file; unsent: one batch may hold many messages
    "halt": SocketBounds(64 * KIB, 256, 1_000),
    "workers": SocketBounds(8 << 20, 1_000, 1_000),  # products may have megabytes; a worker holds at most 128 jobs
    "subsystems": SocketBounds(256 * KIB, 1_000, 10_000),
    "supervisor": SocketBounds(256 * KIB, 1_000, 1_000),
    "events": SocketBounds(1 * KIB, 100, 10_000),  # receives only subscriptions
    "world": SocketBounds(256 * KIB, 256, 256),  # a client waits for each answer
    "estop": SocketBounds(64 * KIB, 256, 1_000),
    "telemetry": SocketBounds(1 * KIB, 100, 100),
    "operate": SocketBounds(4 * KIB, 16, 64),  # a stream: what waits here is stale
    "bench": SocketBounds(64 * KIB, 64, 64),
}


def _not_of_a_cluster(run_dir: Path) -> list[str]:
    """Files in a directory without a cluster's lock file; keys are allowed, they may be made before the first run."""
    names = sorted(path.name for path in run_dir.iterdir())
    return [] if LOCK in names else [name for name in names if name != KEYS]


def default_run_dir() -> Path:
    """The run directory of commands that name none."""
    return Path(environment.run_dir())


def shell_command(words: str, run_dir: Path) -> str:
    """The shell command `words` for the cluster in `run_dir`; the default directory needs no option."""
    same = run_dir.absolute() == default_run_dir().absolute()
    return words if same else f"{words} --run-dir {shlex.quote(str(run_dir))}"


def prepare_run_dir(run_dir: Path) -> Path:
    """Make the run directory, private to its owner (0700); its absolute path.

    Raises ClusterError if sockets in it would not work, or if it holds files that do not belong to a cluster. A new
    cluster deletes what the previous one left.
    """
    run_dir = run_dir.absolute()
    longest = max(len(str(run_dir / file).encode()) for file in ENDPOINTS.values()) + len("-9")
    if longest > SUN_PATH_LIMIT:
        raise ClusterError(
            f"run directory too long for sockets: {run_dir} makes paths of {longest} bytes, "
            f"{SUN_PATH_LIMIT} is the limit; choose a shorter --run-dir"
        )
    try:
        run_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
        if run_dir.stat().st_uid != os.getuid():
            raise ClusterError(f"run directory {run_dir} belongs to another user; choose another --run-dir")
        if others := _not_of_a_cluster(run_dir):
            raise ClusterError(
                f"{run_dir} is not a run directory; it has {', '.join(others[:3])}{' and more' if others[3:] else ''}; "
                "choose a new or empty --run-dir"
            )
        run_dir.chmod(0o700)
    except OSError as error:
        raise ClusterError(f"{run_dir} cannot be a run directory: {error.strerror}; choose another --run-dir") from None
    return run_dir

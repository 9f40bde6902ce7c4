"""One typed set of settings per cluster, read once in `main` and passed down; nothing else reads the environment."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import msgspec

from rtc.outcomes import ClusterError

SUN_PATH_LIMIT = 107  # bytes of a Unix socket's path on Linux


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """How one cluster is made up. Written to `settings.json` in the run directory by whoever starts it."""

    run_dir: str
    run: str = ""  # identifies this run: what an earlier run left in the directory is not continued
    cell: str = "swapout"  # name or file
    dim: int = 2  # of the cube: 2^dim workers
    least_workers: int | None = None  # of each kind, when there is little to do; None = as many as the cube has
    most_workers: int = 4  # of each kind, when jobs wait
    mcm: str = "bullet"  # or "kinematic"
    speed: float = 1.0  # simulated seconds per second; 0 = as fast as possible
    seed: int = 0
    listen: str = ""  # tcp://HOST:PORT, where the gate is for other machines; empty = there is none

    far = False  # its processes are on this machine, and its clock is ours

    @property
    def path(self) -> Path:
        return Path(self.run_dir)

    @property
    def least(self) -> int:
        """Workers of each kind that there are always."""
        return 1 << (self.dim - 2) if self.least_workers is None else self.least_workers

    @property
    def patience(self) -> float:
        """Seconds of ours per simulated second, at least 1: the factor of limits on our clock for motions."""
        return 1.0 / self.speed if 0.0 < self.speed < 1.0 else 1.0

    def endpoint(self, name: str) -> str:
        """The ZeroMQ address of one of the cluster's sockets; see ENDPOINTS."""
        assert name in ENDPOINTS, name
        return f"ipc://{self.path / ENDPOINTS[name]}"

    def secure(self, socket: object) -> None:
        """Nothing to do: the directory is its owner's alone."""

    def save(self) -> None:
        (self.path / "settings.json").write_bytes(msgspec.json.format(msgspec.json.encode(self)))

    @staticmethod
    def load(run_dir: str | Path) -> Settings:
        """The settings of the cluster in `run_dir`. Raises FileNotFoundError when there is none."""
        return msgspec.json.decode((Path(run_dir) / "settings.json").read_bytes(), type=Settings)


# In the run directory:
LOCK = "supervisor.lock"  # held as long as the supervisor lives; the kernel lets go of it however it dies
KEYS = "keys"  # a directory: who may come from elsewhere
# socket -> file in the run directory, who binds it, and its kind
ENDPOINTS: dict[str, str] = {
    "front": "front.sock",  # broker ROUTER: clients
    "halt": "halt.sock",  # broker ROUTER: halts and nothing else
    "workers": "workers.sock",  # broker ROUTER
    "subsystems": "subsystems.sock",  # broker ROUTER
    "supervisor": "supervisor.sock",  # broker ROUTER: the supervisor
    "events": "events.sock",  # broker PUB: ProgressNote, CommandEnded
    "world": "world.sock",  # world database ROUTER
    "estop": "estop.sock",  # MCM ROUTER: halts and nothing else
    "telemetry": "telemetry.sock",  # MCM PUB
    "bench": "bench.sock",  # MCM ROUTER: truth and belief errors, simulators only
}


#: Sockets where a client is not cut off by a newer one of the same identity: the newer one is not heard.
NO_HANDOVER = ("front", "halt", "estop")


class Bounds(NamedTuple):
    """What one peer of a socket may make its owner keep. Whoever has this much unread has to wait; an answer that finds
    so many unsent before it is dropped, for who does not read cannot be helped; a larger frame cuts its sender off."""

    frame: int  # bytes
    unread: int  # messages from this peer
    unsent: int  # messages to it


KIB = 1 << 10
BOUNDS: dict[str, Bounds] = {
    "front": Bounds(256 * KIB, 256, 10_000),  # the largest is a program file; a client is told much in one turn
    "halt": Bounds(64 * KIB, 256, 1_000),
    "workers": Bounds(8 << 20, 1_000, 1_000),  # products may have megabytes; a worker holds 128 jobs at most
    "subsystems": Bounds(256 * KIB, 1_000, 10_000),
    "supervisor": Bounds(256 * KIB, 1_000, 1_000),
    "events": Bounds(1 * KIB, 100, 10_000),  # what comes in are subscriptions
    "world": Bounds(256 * KIB, 256, 256),  # whoever asks waits for the answer
    "estop": Bounds(64 * KIB, 256, 1_000),
    "telemetry": Bounds(1 * KIB, 100, 100),
    "bench": Bounds(64 * KIB, 64, 64),
}


def _not_of_a_cluster(run_dir: Path) -> list[str]:
    """What lies in a directory that no cluster has run in; keys may be made before the first one runs."""
    names = sorted(path.name for path in run_dir.iterdir())
    return [] if LOCK in names else [name for name in names if name != KEYS]


def default_run_dir() -> Path:
    """RTC_RUN_DIR, or a directory of this user alone."""
    if given := os.environ.get("RTC_RUN_DIR"):
        return Path(given)
    base = os.environ.get("XDG_RUNTIME_DIR")
    return Path(base) / "rtc" if base else Path(f"/tmp/rtc-{os.getuid()}")


def prepare_run_dir(run_dir: Path) -> Path:
    """Make the directory, for its owner alone (0700). Raises ClusterError when sockets in it would not work, or when it
    holds what is not a cluster's: a cluster clears away what the one before it has left."""
    run_dir = run_dir.absolute()
    longest = max(len(str(run_dir / file).encode()) for file in ENDPOINTS.values())
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
                f"{run_dir} is no run directory: it holds {', '.join(others[:3])}{' and more' if others[3:] else ''}; "
                "choose a --run-dir that is new or empty"
            )
        run_dir.chmod(0o700)
    except OSError as error:
        raise ClusterError(f"{run_dir} cannot be a run directory: {error.strerror}; choose another --run-dir") from None
    return run_dir

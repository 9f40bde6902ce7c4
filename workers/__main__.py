"""Entry point of a worker process: `python -m rtc workers --run-dir D --kind binder --node 2`.

With --template the process is the fork server: it forks one worker per order {"kind", "node"}. With a worker's key it
joins a cluster on another machine: `python -m rtc workers --kind binder --with w.key`.

A worker imports only the module of its own kind, and does so before it signals `ready`. A parser therefore does not
load robot models.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import msgspec

from rtc.protocol.messages import NODES, WorkerKind
from rtc.protocol.outcomes import ClusterError, KeyTrouble
from rtc.runtime import fork_server, handover, process, time_limit
from rtc.runtime.environment import systemd_socket
from rtc.runtime.keys import KeyFile
from rtc.runtime.memory_guard import limit_data
from workers.runtime.contact import LIMIT_S, BrokerContact, Systemd
from workers.runtime.preload import preload
from workers.runtime.start import join, rehearse, work


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(prog="python -m rtc workers", description="One worker of a cluster.")
    where = made.add_mutually_exclusive_group(required=True)
    where.add_argument("--run-dir", type=Path)
    where.add_argument(
        "--with", dest="key", type=Path, metavar="FILE", help="a worker's key, for a cluster on another machine"
    )
    made.add_argument("--template", action="store_true", help="run as the fork server for workers")
    made.add_argument("--kind", choices=[kind.value for kind in WorkerKind])
    made.add_argument(
        "--rehearser", type=int, metavar="N", help="run as rehearser N, for TEST sentences, without --kind"
    )
    made.add_argument("--node", type=int, help="address in the cube; with --with the cluster assigns one by default")
    made.add_argument(
        "--lost-after",
        type=float,
        metavar="S",
        help=f"with --with: end if the broker has not answered for this time (s); default: {LIMIT_S:g}",
    )
    made.add_argument(
        "--health",
        type=Path,
        metavar="FILE",
        help="with --with: write the time of the broker's last answer to FILE, for the probe workers.runtime.health",
    )
    handover.add_option(made)
    return made


def main() -> None:
    asked = parser()
    given = asked.parse_args()
    time_limit.install()
    if given.key is None and (given.lost_after is not None or given.health is not None):
        asked.error("--lost-after and --health are for workers with a key (--with); a supervisor watches the others")
    if given.lost_after is not None and not given.lost_after > 0.0:
        asked.error("--lost-after must be longer than 0 s")
    if given.template and given.key is not None:
        asked.error("--template is for workers of this machine (--run-dir); one line starts one worker with a key")
    if given.node is not None and not 0 <= given.node < NODES:
        asked.error(f"--node must be from 0 to {NODES - 1}")
    kind = WorkerKind(given.kind) if given.kind else None
    if given.template:
        serve(handover.load(given.run_dir, given.handed))
    elif given.rehearser is not None:
        if given.run_dir is None:
            asked.error("--rehearser is for workers of the cluster's own machine (--run-dir)")
        handed = handover.load(given.run_dir, given.handed)
        rehearse(handed, given.rehearser, preload(WorkerKind, handed.settings.cell))
    elif kind is None or (given.node is None and given.key is None):
        asked.error("a worker needs --kind, and without a key --node")
    elif given.key:
        far(given.key, kind, given.node, given.lost_after or LIMIT_S, given.health)
    else:
        handed = handover.load(given.run_dir, given.handed)
        work(handed, kind, given.node, preload([kind], handed.settings.cell))


class WorkerOrder(msgspec.Struct, frozen=True):
    """Of a worker: `node` is its address. Without a kind it is a rehearser, and `node` its number."""

    node: int
    kind: WorkerKind | None = None


def serve(handed: handover.Handover) -> None:
    """Run as the fork server: preload programs and models for all kinds, then fork one worker per order."""
    process.log_to_stderr()
    prepared = preload(WorkerKind, handed.settings.cell)
    read = msgspec.json.Decoder(WorkerOrder).decode

    def be(order: bytes) -> None:
        wanted = read(order)
        if wanted.kind is None:
            rehearse(handed, wanted.node, prepared)
        else:
            work(handed, wanted.kind, wanted.node, prepared)

    fork_server.serve(be)


def far(path: Path, kind: WorkerKind, node: int | None, lost_after_s: float, health: Path | None) -> None:
    """Run as a worker of a cluster on another machine. Raises SystemExit with the reason if it ends by itself."""
    process.show_name(kind.value)
    limit_data()
    try:
        key = KeyFile.load(path)
        with process.start(kind.value if node is None else f"{kind}@{node}", ".") as me:
            systemd = Systemd(address) if (address := systemd_socket()) else None
            join(key, kind, node, BrokerContact(process.now_s(), lost_after_s, health, systemd), me)
    except (ClusterError, KeyTrouble) as error:
        raise SystemExit(str(error)) from None


if __name__ == "__main__":
    main()

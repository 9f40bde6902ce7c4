"""`python -m deploy up|down`: what `rtc up` and `rtc down` run."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from deploy import cluster
from rtc.keys import check_address
from rtc.outcomes import NoCluster, RtcError
from rtc.settings import Settings, default_run_dir

MOST_WORKERS = 64  # of a kind; a desk has fewer cores


def main(arguments: list[str] | None = None) -> int:
    """0 = ready and, later, ended in order; 1 = it did not come up."""
    given = _parser().parse_args(arguments)
    run_dir: Path = (given.run_dir or default_run_dir()).absolute()
    try:
        return _down(run_dir) if given.what == "down" else _up(given, run_dir)
    except RtcError as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


def _up(given: argparse.Namespace, run_dir: Path) -> int:
    cell = str(Path(given.cell).absolute()) if Path(given.cell).suffix in (".yaml", ".yml") else given.cell
    settings = Settings(
        run_dir=str(run_dir),
        cell=cell,
        dim=given.dim,
        least_workers=given.least,
        most_workers=given.most,
        mcm=given.mcm,
        speed=given.speed,
        seed=given.seed,
        listen=check_address(given.listen) if given.listen else "",
    )
    if given.detach:
        cluster.up_detached(settings, say)
    else:
        cluster.up(settings, say)
    return 0


def _down(run_dir: Path) -> int:
    try:
        pid = cluster.down(run_dir)
    except NoCluster as error:
        print(error)  # what was wanted is so
        return 0
    print(f"the cluster in {run_dir} has ended (supervisor pid {pid})")
    return 0


def say(line: str) -> None:
    print(line, flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m deploy", description="Start and stop a cluster.")
    what = parser.add_subparsers(dest="what", required=True)
    up = what.add_parser("up", help="start a cluster and stay with it until Ctrl-C")
    up.add_argument("--cell", default="swapout", help="name of a cell, or a cell file")
    up.add_argument("--dim", type=int, default=2, choices=range(2, 9), help="of the cube: 2^dim workers")
    up.add_argument("--least", type=_count, default=None, help="workers of each kind; else as many as the cube has")
    up.add_argument("--most", type=_count, default=4, help="workers of each kind, while jobs wait")
    up.add_argument("--mcm", default="bullet", choices=("bullet", "kinematic"))
    up.add_argument("--speed", type=_speed, default=1.0, help="simulated seconds per second, or max")
    up.add_argument("--seed", type=int, default=0)
    up.add_argument("--listen", default="", help="tcp://HOST:PORT, where known keys are let in from other machines")
    up.add_argument("-d", "--detach", action="store_true", help="return once it is ready")
    down = what.add_parser("down", help="stop it in order")
    for command in (up, down):
        command.add_argument("--run-dir", type=Path, default=None)
    return parser


def _count(text: str) -> int:
    count = int(text)
    if not 0 <= count <= MOST_WORKERS:
        raise ValueError
    return count


def _speed(text: str) -> float:
    if text == "max":
        return 0.0
    speed = float(text)
    if speed < 0:
        raise ValueError
    return speed


if __name__ == "__main__":
    sys.exit(main())

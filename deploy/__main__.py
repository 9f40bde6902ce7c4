"""`python -m deploy up|down`: what `rtc up` and `rtc down` run."""

from __future__ import annotations

import argparse
import math
import signal
import sys
from pathlib import Path

from deploy import cluster
from rtc.protocol.outcomes import ClusterError, NoCluster, ProgramError, RtcError
from rtc.runtime.keys import check_address
from rtc.runtime.settings import Settings, default_run_dir

CELL = "swapout"  # default cell
MOST_WORKERS = 64  # maximum number of workers of a kind
WRONG = 2  # exit status for an invalid option, as in argparse


def main(arguments: list[str] | None = None) -> int:
    """Exit status: 0 = the cluster became ready and ended in order; 1 = it did not start; 2 = invalid option."""
    given = _parser().parse_args(arguments)
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # `rtc up` has blocked it until here
        return _obey(given, (given.run_dir or default_run_dir()).absolute())
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


def _obey(given: argparse.Namespace, run_dir: Path) -> int:
    if given.what == "up":
        try:
            settings = settings_of(given, run_dir)
        except RtcError as error:
            print(error, file=sys.stderr)
            return WRONG
    try:
        return _down(run_dir) if given.what == "down" else _up(settings, given.detach)
    except RtcError as error:
        print(error, file=sys.stderr)
        return 1


def settings_of(given: argparse.Namespace, run_dir: Path) -> Settings:
    """The checked options. Raises RtcError for an invalid option."""
    if given.least is not None and given.least > given.most:
        raise ClusterError(f"--least {given.least} is more than --most {given.most}: use --most {given.least} or more")
    return Settings(
        run_dir=str(run_dir),
        cell=_cell(given.cell),
        dim=given.dim,
        least_workers=given.least,
        most_workers=given.most,
        mcm=given.mcm,
        speed=given.speed,
        listen=check_address(given.listen) if given.listen else "",
    )


def _cell(text: str) -> str:
    """The name of a cell, or the absolute path of its file. Raises ProgramError."""
    if text == CELL:
        return text  # unchecked: the check imports numpy, which would delay the start of the processes
    path = Path(text)
    is_yaml = path.suffix in (".yaml", ".yml")
    if path.is_file() and not is_yaml:
        raise ProgramError(
            f"{text} is not a cell: a cell is a .yaml file, a directory with a cell.yaml in it, or a name"
        )
    from rtc.cells.cell import Cell

    Cell.load(text)
    return str(path.absolute()) if is_yaml else text


def _up(settings: Settings, detach: bool) -> int:
    if detach:
        cluster.up_detached(settings, show)
    else:
        cluster.up(settings, show)
    return 0


def _down(run_dir: Path) -> int:
    try:
        pid, stopped = cluster.down(run_dir)
    except NoCluster as error:
        print(error)  # the requested state holds already
        return 0
    if stopped:
        print(stopped)
    print(f"the cluster in {run_dir} has ended (supervisor pid {pid})")
    return 0


def show(line: str) -> None:
    print(line, flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m deploy", description="Start and stop a cluster.")
    what = parser.add_subparsers(dest="what", required=True)
    up = what.add_parser("up", help="start a cluster and run it until Ctrl-C")
    up.add_argument("--cell", default=CELL, help="name of a cell, or a cell file")
    up.add_argument("--dim", type=int, default=2, choices=range(2, 9), help="dimension of the cube: 2^dim workers")
    up.add_argument("--least", type=_count, default=None, help="minimum workers of each kind; default: the whole cube")
    up.add_argument("--most", type=_count, default=4, help="maximum workers of each kind, while jobs wait")
    up.add_argument("--mcm", default="bullet", choices=("bullet", "kinematic"))
    up.add_argument("--speed", type=_speed, default=1.0, help="simulated seconds per second, or max")
    up.add_argument("--listen", default="", help="tcp://HOST:PORT for clients on other machines, with known keys")
    up.add_argument("-d", "--detach", action="store_true", help="return when the cluster is ready")
    down = what.add_parser("down", help="stop the cluster in order")
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
    if not 0 <= speed < math.inf:
        raise ValueError
    return speed


if __name__ == "__main__":
    sys.exit(main())

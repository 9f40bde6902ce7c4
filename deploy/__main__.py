"""`python -m deploy up|down`: the process that `rtc up` and `rtc down` become.

The options are declared in `rtc.apps.cli.cluster`, which passes `Settings` as JSON.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from pathlib import Path

import msgspec

from deploy import cluster
from deploy.more_workers import check_more
from rtc.protocol.outcomes import ClusterError, NoCluster, ProgramError, RtcError
from rtc.protocol.subsystems import DEFAULTS, Subsystem
from rtc.runtime.extras import missing
from rtc.runtime.keys import check_address
from rtc.runtime.settings import Settings

CELL = Settings(run_dir="").cell  # default cell
INVALID_OPTION = 2  # exit status for an invalid option, as in argparse


def main(arguments: list[str] | None = None) -> int:
    """Exit status: 0 = the cluster became ready and ended in order; 1 = it did not start; 2 = invalid option."""
    given = _parser().parse_args(arguments)
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # `rtc up` has blocked it until here
        return _run(given)
    except KeyboardInterrupt:
        print("rtc: interrupted", file=sys.stderr)
        return 130


def _run(given: argparse.Namespace) -> int:
    if given.what == "up":
        try:
            settings = validate(msgspec.json.decode(given.settings, type=Settings))
        except (RtcError, msgspec.MsgspecError) as error:
            print(f"rtc: {error}", file=sys.stderr)
            return INVALID_OPTION
    try:
        return _down(given.run_dir.absolute()) if given.what == "down" else _up(settings, given.detach)
    except RtcError as error:
        print(f"rtc: {error}", file=sys.stderr)
        return 1


def validate(settings: Settings) -> Settings:
    """The settings with absolute paths. Raises RtcError for values that the types do not exclude."""
    if (settings.least_workers or 0) > settings.most_workers:
        least, most = settings.least_workers, settings.most_workers
        raise ClusterError(f"--least {least} is more than --most {most}: use --most {least} or more")
    if settings.listen:
        check_address(settings.listen)
    check_more(settings)
    if settings.record:
        _check_recordings(Path(settings.record))
    run_dir = str(Path(settings.run_dir).absolute())
    cell, subsystems = _cell(settings.cell)
    return msgspec.structs.replace(settings, run_dir=run_dir, cell=cell, subsystems=tuple(subsystems))


def _check_recordings(folder: Path) -> None:
    """Raises ClusterError if nothing can be recorded into this directory."""
    if need := missing("record"):
        raise ClusterError(f"--record: {need}")
    if not os.access(folder, os.W_OK):
        raise ClusterError(f"--record: no file can be written in {folder}, the current directory")


def _cell(text: str) -> tuple[str, list[Subsystem]]:
    """The name of a cell, or the absolute path of its file; and its subsystems. Raises ProgramError."""
    if text == CELL:
        return text, list(DEFAULTS)  # unchecked: the check imports numpy, which would delay the start of the processes
    path = Path(text)
    is_yaml = path.suffix in (".yaml", ".yml")
    if path.is_file() and not is_yaml:
        raise ProgramError(
            f"{text} is not a cell: a cell is a .yaml file, a directory with a cell.yaml in it, or a name"
        )
    from rtc.model.cells.cell import Cell
    from rtc.model.robot.finger_mass import require_stable

    cell = require_stable(Cell.load(text))
    return str(path.absolute()) if is_yaml else text, cell.all_subsystems


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
    parser = argparse.ArgumentParser(prog="python -m deploy", description="Start and stop a cluster: see rtc up -h.")
    what = parser.add_subparsers(dest="what", required=True)
    up = what.add_parser("up", help="start a cluster and run it until Ctrl-C")
    up.add_argument("settings", help="rtc.runtime.settings.Settings as JSON")
    up.add_argument("-d", "--detach", action="store_true", help="return when the cluster is ready")
    down = what.add_parser("down", help="stop the cluster in order")
    down.add_argument("run_dir", type=Path)
    return parser


if __name__ == "__main__":
    sys.exit(main())

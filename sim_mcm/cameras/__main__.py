"""The process S&P of a simulated cell: `python -m sim_mcm.cameras --run-dir D`. Its cameras are drawn."""

from __future__ import annotations

import argparse
from pathlib import Path

from rtc.protocol.subsystems import CAMERAS
from rtc.runtime import handover
from rtc.subsystems.perception.station import live
from sim_mcm.cameras.simulated import SimulatedCameras


def main() -> None:
    arguments = argparse.ArgumentParser(prog="python -m sim_mcm.cameras", description=__doc__)
    arguments.add_argument("--run-dir", required=True, type=Path, help="run directory of the cluster")
    arguments.add_argument("--name", default=CAMERAS.name, help="its name as a subsystem of the cell")
    handover.add_option(arguments)
    given = arguments.parse_args()
    live(given.run_dir, given.name, given.handed, SimulatedCameras)


if __name__ == "__main__":
    main()

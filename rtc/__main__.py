"""Run a program of a room: `python -m rtc workers --kind binder --with w.key`.

In a checkout the rooms `broker`, `workers`, `sim_mcm` and `deploy` stand beside `rtc`. The wheel has them in a folder
of `rtc`, so that their common names are not installed for all programs. Processes of rtc find them there.
"""

from __future__ import annotations

import runpy
import sys

from rtc.runtime import environment


def main() -> None:
    if len(sys.argv) < 2:
        sys.exit("usage: python -m rtc MODULE ...; such as python -m rtc workers -h")
    environment.use_rooms()
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()

"""The mechanisms of installed packages, for `rtc doctor`: `python -m workers.runtime.installed_mechanisms` prints them.

It is a process of its own, because a package may end the process that imports it.
"""

from __future__ import annotations

import sys

import msgspec

from rtc.runtime import time_limit
from workers.mechanisms import installed


def main() -> None:
    time_limit.install()
    rows = installed()
    known = {"found": [row.name for row in rows.used], "failed": dict(rows.failed)}
    sys.stdout.write(msgspec.json.encode(known).decode())


if __name__ == "__main__":
    main()

"""The only module that reads the environment. Imports nothing that is slow: `rtc halt` begins with it."""

from __future__ import annotations

import os
import sys

ROOMS = os.path.join(os.path.dirname(os.path.dirname(__file__)), "rooms")  # where an installed rtc has them


def run_dir() -> str:
    """RTC_RUN_DIR, or a directory private to this user."""
    if given := os.environ.get("RTC_RUN_DIR"):
        return given
    base = os.environ.get("XDG_RUNTIME_DIR")
    return f"{base}/rtc" if base else f"/tmp/rtc-{os.getuid()}"


def use_rooms() -> None:
    """Let this process and those that it starts import `broker`, `workers`, `sim_mcm` and `deploy` of an installed rtc,
    before other packages of these names. In a checkout they stand beside `rtc`."""
    if os.path.isdir(ROOMS) and ROOMS not in sys.path:
        sys.path.insert(0, ROOMS)
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (ROOMS, os.environ.get("PYTHONPATH"))))


def all_variables() -> dict[bytes, bytes]:
    """The whole environment, for a process that takes the place of this one."""
    return dict(os.environb)


def replace(variables: dict[bytes, bytes]) -> None:
    """Be in this environment from now on."""
    os.environb.clear()
    os.environb.update(variables)


def module_path() -> str:
    """PYTHONPATH."""
    return os.environ.get("PYTHONPATH", "")


def data_dir() -> str:
    """Directory of this user's data that outlive a run: XDG_DATA_HOME, or ~/.local/share."""
    return f"{os.environ.get('XDG_DATA_HOME') or os.path.expanduser('~/.local/share')}/rtc"


def systemd_socket() -> str:
    """NOTIFY_SOCKET: the address for `sd_notify`; empty if systemd expects no notification."""
    return os.environ.get("NOTIFY_SOCKET", "")


def colours() -> bool:
    """Whether a terminal may get colours: not with NO_COLOR, and not if TERM is dumb."""
    return not os.environ.get("NO_COLOR") and os.environ.get("TERM", "") not in ("", "dumb")


def physics_seed() -> str:
    """RTC_PHYSICS_SEED: each simulation with physics differs a little from its cell file, and by
    the same for the same seed. For tests; empty: it is as the file states."""
    return os.environ.get("RTC_PHYSICS_SEED", "")

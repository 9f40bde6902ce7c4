"""Keeper of a demo's cluster: starts it, and ends it when the demo ends, however that happens. A process of its own.

    python -m rtc.apps.demos.keeper RUN_DIR SETTINGS     # settings of the cluster, as JSON

It writes one line when the cluster is up, or has failed to come up, and waits for the end of its standard input. The
system closes that when the demo ends, even by SIGKILL. It has a session of its own, so that neither Ctrl-C nor a closed
terminal reaches it. This module imports nothing of rtc: it waits in each demo.
"""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys

READY_S, DOWN_S = 700.0, 300.0  # longer than the limits of `rtc up` and `rtc down` themselves, on a busy machine


def main() -> int:
    run_dir, settings = sys.argv[1:]
    signal.signal(signal.SIGTERM, lambda *_: None)  # not SIG_IGN, which the processes of the cluster would inherit
    missing = _deploy(READY_S, "up", "-d", "--", settings)
    try:
        print(json.dumps(missing), flush=True)
        if not missing:
            sys.stdin.read()
    except OSError:  # the demo has ended already
        pass
    try:
        left = _deploy(DOWN_S, "down", "--", run_dir)
    finally:
        shutil.rmtree(run_dir, ignore_errors=True)
    if left and not missing:
        sys.stderr.write(left)
    return 1 if missing or left else 0


def _deploy(limit_s: float, what: str, *given: str) -> str:
    """Do what `rtc WHAT` becomes; why it failed, or empty."""
    command = [sys.executable, "-P", "-m", "deploy", what, *given]
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=limit_s)
    except subprocess.TimeoutExpired:
        return f"the cluster did not answer `{what}` within {limit_s:.0f} s"
    return f"cluster {what} failed: {(done.stdout + done.stderr).strip()[-2000:]}" if done.returncode else ""


if __name__ == "__main__":
    sys.exit(main())

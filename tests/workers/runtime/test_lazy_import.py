"""Workers start without a plotting library, and it can still be had afterwards."""

from __future__ import annotations

import subprocess
import sys

import pytest

LOOK = """
import sys
from workers.runtime import lazy_import
lazy_import.load("workers.planning.motion.timing")
assert "toppra" in sys.modules
print(sorted(name for name in sys.modules if name.startswith(("matplotlib", "mpl_toolkits"))))
import toppra, matplotlib.pyplot
print(matplotlib.pyplot.figure.__module__)
"""


@pytest.mark.slow
@pytest.mark.untimed
def test_motions_are_imported_without_plotting():
    done = subprocess.run([sys.executable, "-c", LOOK], capture_output=True, text=True, timeout=60)
    assert done.stdout == "[]\nmatplotlib.pyplot\n", done.stderr

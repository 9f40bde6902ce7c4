"""Workers start without toppra, which few motions need, and never load a plotting library."""

from __future__ import annotations

import subprocess
import sys

import pytest

LOOK = """
import sys
from workers.runtime import lazy_import
for kind in lazy_import.FUNCTIONS:
    lazy_import.load(kind)
print(sorted({name.split(".")[0] for name in sys.modules} & {"toppra", "scipy", "matplotlib", "mpl_toolkits"}))
import workers.planning.motion.within_torques
assert "toppra" in sys.modules
print(sorted(name for name in sys.modules if name.startswith(("matplotlib", "mpl_toolkits"))))
import toppra, matplotlib.pyplot
print(matplotlib.pyplot.figure.__module__)
"""


@pytest.mark.slow
@pytest.mark.untimed
def test_workers_start_without_toppra_and_never_plot():
    done = subprocess.run([sys.executable, "-c", LOOK], capture_output=True, text=True, timeout=60)
    assert done.stdout == "[]\n[]\nmatplotlib.pyplot\n", done.stderr

"""The fixtures of the executor's tests: the simulator is tested with the same primitives."""

from tests.subsystems.motion.conftest import cell, make, rig  # noqa: F401

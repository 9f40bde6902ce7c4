"""The compiled part of the build, and the place of the rooms in a wheel; all else stands in pyproject.toml.

Without a compiler that part is left out. The rooms are in `rtc/rooms`: one name is installed (decision 0166)."""

import shutil
from glob import glob
from pathlib import Path

from pybind11.setup_helpers import Pybind11Extension
from setuptools import setup
from setuptools.command.build_py import build_py


class OneName(build_py):
    """Also moves the rooms, unless they are used from the checkout."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            for room in ("broker", "workers", "sim_mcm", "deploy"):
                shutil.rmtree(Path(self.build_lib, "rtc", "rooms", room), ignore_errors=True)
                shutil.move(Path(self.build_lib, room), Path(self.build_lib, "rtc", "rooms", room))


setup(
    cmdclass={"build_py": OneName},
    ext_modules=[
        Pybind11Extension(
            "rtc.model.robot._boxes",
            ["rtc/model/robot/_boxes.cpp"],
            depends=sorted(glob("rtc/model/robot/_*.hpp")),
            cxx_std=17,
            extra_compile_args=["-O3"],
            optional=True,
        )
    ],
)

"""The compiled part of the build; everything else stands in pyproject.toml. Without a compiler it is left out."""

from glob import glob

from pybind11.setup_helpers import Pybind11Extension
from setuptools import setup

setup(
    ext_modules=[
        Pybind11Extension(
            "rtc.model.robot._boxes",
            ["rtc/model/robot/_boxes.cpp"],
            depends=sorted(glob("rtc/model/robot/_*.hpp")),
            cxx_std=17,
            extra_compile_args=["-O3"],
            optional=True,
        )
    ]
)

"""Importing a worker's module without what no worker uses.

toppra imports matplotlib.pyplot for its plotting methods; that is 0.4 s of processor time in every start, and nobody
plots in a worker. An empty module stands in for it while the worker's modules are imported, and is gone afterwards.
"""

from __future__ import annotations

import contextlib
import importlib
import sys
from collections.abc import Iterator
from types import ModuleType


def load(name: str) -> ModuleType:
    """The module `workers.NAME`, imported without plotting."""
    with _no_plots():
        return importlib.import_module(f"workers.{name}")


@contextlib.contextmanager
def _no_plots() -> Iterator[None]:
    if "matplotlib" in sys.modules:
        yield
        return
    package, pyplot = ModuleType("matplotlib"), ModuleType("matplotlib.pyplot")
    package.pyplot = pyplot  # type: ignore[attr-defined]
    stand_ins = {"matplotlib": package, "matplotlib.pyplot": pyplot}
    sys.modules.update(stand_ins)
    try:
        yield
    finally:
        for name in stand_ins:
            del sys.modules[name]

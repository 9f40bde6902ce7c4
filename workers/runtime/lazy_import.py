"""Import a worker's module without matplotlib.

toppra imports matplotlib.pyplot for its plotting methods, which takes 0.4 s of processor time at every start. Workers
do not plot. An empty module replaces matplotlib during the import and is removed afterwards.
"""

from __future__ import annotations

import contextlib
import importlib
import sys
from collections.abc import Iterator
from types import ModuleType

#: kind of worker -> the module with its function
FUNCTIONS = {
    "parser": "workers.parser.parse",
    "elaborator": "workers.elaborator.elaborate",
    "binder": "workers.binder.bind",
    "analyzer": "workers.analyzer.analyze",
    "rehearser": "workers.rehearsal.rehearse",
}


def load(name: str) -> ModuleType:
    """Import a kind of worker, or the module of that dotted name, without matplotlib."""
    with _no_plots():
        return importlib.import_module(FUNCTIONS.get(name, name))


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

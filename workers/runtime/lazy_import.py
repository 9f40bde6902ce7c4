"""Import a worker's module when its kind is known, so that a worker loads what its kind needs."""

from __future__ import annotations

import importlib
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
    """Import a kind of worker, or the module of that dotted name."""
    return importlib.import_module(FUNCTIONS.get(name, name))

"""The optional libraries of the observers, and the message for a user who has not installed them."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, requires
from importlib.util import find_spec

#: extra of pyproject.toml -> the modules that it must bring
EXTRAS = {
    "record": ("mcap", "foxglove_schemas_protobuf", "mcap_protobuf"),
    "prometheus": ("prometheus_client",),
    "otlp": ("opentelemetry.sdk", "opentelemetry.exporter.otlp.proto.http"),
}
INSTALLED_BY = {"record": "record", "prometheus": "observe", "otlp": "observe"}


def missing(purpose: str) -> str:
    """What to install for this purpose, a key of EXTRAS; empty if it is installed."""
    absent = [name for name in EXTRAS[purpose] if not _found(name)]
    if not absent:
        return ""
    return f"this needs {', '.join(absent)}: pip install {' '.join(requirements(INSTALLED_BY[purpose]))}"


def requirements(extra: str) -> list[str]:
    """The names of the packages of an extra, for pip."""
    try:
        stated = requires("telerobot-rtc") or []
    except PackageNotFoundError:
        stated = []
    wanted = [each for each in stated if re.search(rf"extra == .{extra}.", each)]
    return [found[0] for each in wanted if (found := re.match(r"[\w.-]+", each))] or [f"telerobot-rtc[{extra}]"]


def _found(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # its parent package is missing
        return False

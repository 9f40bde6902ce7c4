"""Entry points of other packages: found by name, and harmless if they cannot be loaded."""

from __future__ import annotations

from pathlib import Path

from rtc.plugins import registry
from tests.plugins.toy_packages import Install


def test_a_package_that_cannot_be_loaded_is_named_and_the_others_are_used(install: Install) -> None:
    install(registry.REPORT_ITEMS, "GOOD", "measure", "def measure(arm):\n    return 1\n")
    install(registry.REPORT_ITEMS, "BAD", "measure", "import no_such_library\n")
    assert list(registry.installed(registry.REPORT_ITEMS)) == ["GOOD"]
    assert list(registry.loaded(registry.REPORT_ITEMS).failed) == ["BAD"]
    assert "no_such_library" in registry.loaded(registry.REPORT_ITEMS).failed["BAD"]


def test_the_page_has_a_section_for_each_group() -> None:
    page = (Path(__file__).parents[2] / "docs" / "plugins.md").read_text()
    assert [group for group in registry.GROUPS if f"`{group}`" not in page] == []

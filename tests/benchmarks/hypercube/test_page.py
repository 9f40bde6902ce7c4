"""The page of conclusions has the figures of the results files."""

from __future__ import annotations

from benchmarks.hypercube.page import PAGE, TABLES, filled


def test_the_tables_of_the_page_are_those_of_the_results():
    page = PAGE.read_text()
    assert all(f"<!-- table: {name} -->" in page for name in TABLES)
    assert filled(page) == page

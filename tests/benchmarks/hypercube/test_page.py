"""The page of conclusions has the figures of the results files."""

from __future__ import annotations

import re

from benchmarks.hypercube.page import PAGE, TABLES, filled


def test_the_tables_of_the_page_are_those_of_the_results():
    page = PAGE.read_text()
    assert all(f"<!-- table: {name} -->" in page for name in TABLES)
    assert filled(page) == page


def test_the_figures_of_the_conclusions_are_in_the_tables():
    _, conclusions, *others = PAGE.read_text().split("\n## ")
    stated = set(re.findall(r"\d+,\d{3}", conclusions))
    in_tables = {figure for line in "\n".join(others).splitlines() if line.startswith("|") for figure in line.split()}
    assert stated
    assert stated <= in_tables

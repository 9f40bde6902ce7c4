"""The site of the documentation: `make docs`. Sphinx reads the pages where they are, from the root of the checkout."""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from rtc import __version__  # noqa: E402

project = "rtc"
author = copyright = "the maintainers of rtc"
version = release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.viewcode"]
root_doc = "docs/site/index"
source_suffix = {".md": "markdown"}
include_patterns = ["*.md", "docs/**.md", "examples/README.md", "benchmarks/*.md"]
exclude_patterns = [".venv", "out", "build"]
html_theme = "furo"
html_title = f"rtc {version}"
html_extra_path = ["../llms.txt", "root"]
myst_heading_anchors = 3
suppress_warnings = ["misc.highlighting_failure"]  # blocks of sentences and terminals have no language
highlight_language = "none"
nitpicky = False
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_format = "short"

PAGE = re.compile(r"`((?:docs/(?:decisions/)?)?[\w-]+\.md)`")


def link_pages(_: object, name: str, source: list[str]) -> None:
    """A page that a text names becomes a link to it: for readers of files the name is enough."""

    def linked(found: re.Match[str]) -> str:
        page = found[1]
        return f"[{page}](/{page})" if (ROOT / page).is_file() else found[0]

    parts = re.split(r"(^```.*?^```)", source[0], flags=re.MULTILINE | re.DOTALL)
    source[0] = "".join(part if part.startswith("```") else PAGE.sub(linked, part) for part in parts)


def literal_blocks(_app: object, _what: str, _name: str, _value: object, _options: object, lines: list[str]) -> None:
    """An indented block of a docstring is code."""
    for number in range(len(lines) - 1, 0, -1):
        begins = lines[number].startswith("    ") and not lines[number - 1].strip()
        if begins and number > 1 and not lines[number - 2].startswith(" "):
            lines[number:number] = ["::", ""]


def setup(app: object) -> None:
    app.connect("autodoc-process-docstring", literal_blocks)  # type: ignore[attr-defined]
    app.connect("source-read", link_pages)  # type: ignore[attr-defined]

"""The list of all decisions with their status: `python -m tests.decisions_page > docs/decisions/README.md`.

A decision is in force, if its page has no paragraph that begins with `**Status.**` and says otherwise.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from tests.source_files import ROOT

FOLDER = ROOT / "docs" / "decisions"
HEAD = """# Decisions

Each page states a context, a choice and its price. The newest comes last. A page that a later one overtakes says so in
its paragraph **Status**. Numbers that are missing were decisions about what is gone. The page is written by
`python -m tests.decisions_page > docs/decisions/README.md`; a test compares it with the pages.

| decision | status |
|---|---|
"""


def page() -> str:
    return HEAD + "".join(row(path) for path in sorted(FOLDER.glob("[0-9]*.md")))


def row(path: Path) -> str:
    text = path.read_text()
    title = text.partition("\n")[0].removeprefix("# ").replace("|", "\\|")
    stated = re.search(r"^\*\*Status\.\*\* (.*?)(?:\n\n|\Z)", text, re.MULTILINE | re.DOTALL)
    status = " ".join(stated[1].split()) if stated else "in force"
    return f"| [{title}]({path.name}) | {status} |\n"


if __name__ == "__main__":
    sys.stdout.write(page())

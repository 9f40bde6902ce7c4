"""The list of all modules as a page, from their docstrings: `python -m tests.modules_page > docs/modules.md`."""

from __future__ import annotations

import sys
import textwrap
from pathlib import Path

from tests.source_files import ROOT, source

PACKAGES = ("rtc", "broker", "workers", "sim_mcm", "deploy")
HEAD = """# Modules

Each package with its modules, in the words of their docstrings. The page is written by
`python -m tests.modules_page > docs/modules.md`; a test compares it with the code.
"""


def page() -> str:
    folders = sorted({path.parent for name in PACKAGES for path in (ROOT / name).rglob("*.py")})
    return HEAD + "".join(section(folder) for folder in folders)


def section(folder: Path) -> str:
    """Heading, purpose and table of one package; `__init__` is its purpose."""
    modules = sorted(path for path in folder.glob("*.py") if path.name != "__init__.py")
    purpose = textwrap.fill(first_paragraph(folder / "__init__.py"), 118)
    rows = "".join(f"| `{path.stem}` | {first_paragraph(path)} |\n" for path in modules)
    table = f"\n| module | purpose |\n|---|---|\n{rows}" if rows else ""
    return f"\n## `{folder.relative_to(ROOT).as_posix()}/`\n\n{purpose}\n{table}"


def first_paragraph(path: Path) -> str:
    """Of the module's docstring, in one line."""
    return " ".join(source(path).docstring.partition("\n\n")[0].split()).replace("|", "\\|")


if __name__ == "__main__":
    sys.stdout.write(page())

"""rtc docs: the pages of the documentation, of this installation or of this checkout."""

from __future__ import annotations

import sys
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from rtc.apps.cli.output import cli_error, console, table
from rtc.protocol.spelling import unknown

CHECKOUT = Path(__file__).parents[3]
INSTALLED = "share/doc/telerobot-rtc/docs/tutorial.md"  # end of its path in a wheel, see `data-files` of pyproject.toml


def docs(
    page: Annotated[str, typer.Argument(help="A page, such as tutorial; without it, a list.")] = "",
    where: Annotated[bool, typer.Option("--path", help="Print the path of the page, or of all pages.")] = False,
) -> None:
    """The pages of the documentation: a list, or the text of one.

    Example:  rtc docs tutorial
    """
    found = pages()
    if not page and where:
        print(directory())
    elif not page:
        out = table("page", "about")
        for name, each in found.items():
            out.add_row(name, title(each))
        console.print(out)
        console.print(Text(f"rtc docs PAGE prints one; all are in {directory()}"))
    elif (path := found.get(page.removeprefix("docs/").removesuffix(".md"))) is not None:
        sys.stdout.write(f"{path}\n" if where else path.read_text())
    else:
        raise cli_error(unknown("page", page, found), 2)


def pages() -> dict[str, Path]:
    """The pages by name: tutorial, scripts, ... Raises typer.Exit, with the reason printed, if there are none."""
    return {path.stem: path for path in [directory().parent / "README.md", *sorted(directory().glob("*.md"))]}


def directory() -> Path:
    """The directory of the pages: the files that a wheel has installed, else those of the checkout."""
    try:
        installed = [file for file in files("telerobot-rtc") or () if str(file).endswith(INSTALLED)]
    except PackageNotFoundError:
        installed = []
    for found in [*(Path(str(file.locate())).resolve() for file in installed), CHECKOUT / "docs" / "tutorial.md"]:
        if found.is_file():
            return found.parent
    raise cli_error("the pages of the documentation are not installed", 1)


def title(page: Path) -> str:
    """The first heading of a page."""
    return next((line.lstrip("# ") for line in page.read_text().splitlines() if line.startswith("# ")), "")

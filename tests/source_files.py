"""What tests of the code base ask about a Python file; each file is parsed once."""

from __future__ import annotations

import ast
import functools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class SourceFile:
    """Names in one file; modules are dotted, with `from package import module` counted as the module."""

    imports: tuple[tuple[int, str], ...]  # (line, module or package) of all import statements
    at_top: frozenset[str]  # modules that are imported when the file is loaded
    modules: frozenset[str]  # at the top, inside functions, under TYPE_CHECKING, and by name
    texts: frozenset[str]  # values of all texts
    classes: frozenset[str]
    docstring: str


def place(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@functools.cache
def source(path: Path) -> SourceFile:
    tree = ast.parse(path.read_text())
    nodes = list(ast.walk(tree))
    texts = {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    return SourceFile(
        imports=tuple(_imports(place(path), nodes)),
        at_top=frozenset(_modules_imported(tree.body)),
        modules=frozenset([*_modules_imported(nodes), *_named_modules(nodes)]),
        texts=frozenset(texts),
        classes=frozenset(node.name for node in nodes if isinstance(node, ast.ClassDef)),
        docstring=ast.get_docstring(tree) or "",
    )


def _imports(where: str, nodes: Iterable[ast.AST]) -> Iterator[tuple[int, str]]:
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{where}:{node.lineno}: imports are absolute"
            yield node.lineno, node.module or ""


def _modules_imported(nodes: Iterable[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (_imported(node.module, alias.name) for alias in node.names)


@functools.cache
def _imported(package: str, name: str) -> str:
    inner = ROOT / Path(*package.split("."), name)
    is_module = inner.with_suffix(".py").exists() or (inner / "__init__.py").exists()
    return f"{package}.{name}" if is_module else package


def _named_modules(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Arguments of `import_module` and `lazy` imports that are plain texts."""
    for node in nodes:
        if isinstance(node, ast.Call) and "import" in ast.unparse(node.func):
            yield from (one.value for one in node.args if isinstance(one, ast.Constant) and isinstance(one.value, str))

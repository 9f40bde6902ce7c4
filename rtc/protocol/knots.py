"""Rows of numbers that travel as the bytes of doubles: they are neither written nor read number by number. Pure."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from itertools import chain
from typing import Any

BYTES = 8  # of a number: float64, little-endian


class Knots(Sequence[Sequence[float]]):
    """Equally long rows, one after the other in `data`; a row is a list of numbers. numpy reads all without a copy.

    As they arrive they are one row, until `in_rows` is called with the number of rows."""

    __slots__ = ("_columns", "_row", "data")

    def __init__(self, data: bytes) -> None:
        self.data = data
        self._divide(len(data) // BYTES)

    @classmethod
    def of(cls, rows: Iterable[Sequence[float]]) -> Knots:
        """Raises ValueError for rows of different lengths."""
        listed = list(rows)
        made = cls(struct.pack(f"<{sum(map(len, listed))}d", *chain.from_iterable(listed)))
        if len(set(map(len, listed))) > 1:
            raise ValueError("all rows must have the same length")
        return made.in_rows(len(listed))

    def in_rows(self, count: int) -> Knots:
        """The same, of so many rows. Raises ValueError if they cannot be equally long."""
        columns, rest = divmod(len(self.data), BYTES * count) if count else (0, len(self.data))
        if rest or not columns:
            raise ValueError(f"{len(self.data)} bytes are not {count} rows of numbers")
        self._divide(columns)
        return self

    def _divide(self, columns: int) -> None:
        self._columns, self._row = columns, struct.Struct(f"<{columns}d")

    @property
    def columns(self) -> int:
        return self._columns

    @property
    def __array_interface__(self) -> dict[str, Any]:
        shape = (len(self), self._columns)
        return {"version": 3, "typestr": "<f8", "shape": shape, "data": self.data}

    def __len__(self) -> int:
        return len(self.data) // self._row.size if self._columns else 0

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[n] for n in range(*index.indices(len(self)))]
        n = index + len(self) if index < 0 else index
        if not 0 <= n < len(self):
            raise IndexError(index)
        return list(self._row.unpack_from(self.data, n * self._row.size))

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Knots):
            return self._columns == other._columns and list(self) == list(other)
        return list(self) == other if isinstance(other, list) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.data)

    def __repr__(self) -> str:
        return repr(list(self))

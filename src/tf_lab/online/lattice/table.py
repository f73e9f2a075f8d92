"""Columns of tensors that grow together."""

from __future__ import annotations

import torch
from torch import Tensor

# Spare room, so that appending is cheap on average; a host's takes no memory until it is used.
GROWTH = {"cpu": 2.0, "cuda": 1.25}


class Table:
    """Named columns with one row a voxel (or block), appended to as these are first seen.

    Columns are read and written through ``table["name"]``, a view of the rows in use; hold such a
    view no longer than until the next `grow`.

    Args:
        device: where the columns live.
    """

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self.rows = 0
        self._columns: dict[str, Tensor] = {}
        self._fill: dict[str, float] = {}

    def add_column(
        self, name: str, shape: tuple[int, ...], dtype: torch.dtype, fill: float
    ) -> None:
        """A column whose new rows hold ``fill``."""
        self._columns[name] = torch.full((self.rows, *shape), fill, dtype=dtype, device=self.device)
        self._fill[name] = fill

    def __getitem__(self, name: str) -> Tensor:
        return self._columns[name][: self.rows]

    @property
    def row_nbytes(self) -> int:
        """Memory of one row."""
        columns = self._columns.values()
        return sum(c.shape[1:].numel() * c.element_size() for c in columns)

    def grow(self, rows: int, limit: int | None = None) -> None:
        """Make it ``rows`` long (or short), without spare room beyond ``limit`` rows."""
        for name, column in self._columns.items():
            if len(column) < rows:
                spare = round(len(column) * GROWTH.get(self.device.type, GROWTH["cuda"]))
                length = max(rows, spare if limit is None else min(spare, limit))
                larger = column.new_empty((length, *column.shape[1:]))
                larger[: self.rows] = column[: self.rows]
                self._columns[name] = column = larger
            column[self.rows : rows] = self._fill[name]
        self.rows = rows

    def nbytes(self, *names: str) -> int:
        """Memory of the rows in use, of some columns or (without names) of all."""
        return sum(self[name].nbytes for name in names or self._columns)

"""Rows of JointState messages whose joint names stand in cells.

A message lists its joints in any order, and exports keep that order: either element by element in
columns of their own (`name[0]`, `position[0]`, …), or as one list in a cell (`"[0.1, 0.2]"`). The
rows are rewritten so that each column belongs to one joint.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from ..errors import UnusableInput

Rewrite = Callable[[bytes], tuple[bytes, int]]
"""Rewrites complete lines; returns them and the number of rows that were left out."""
BRACKETS = "[](){} \t"
"""Characters around the elements of a list in a cell."""


@dataclass(frozen=True)
class ElementColumns:
    """Columns that hold single elements of the fields of a message.

    Attributes:
        source: Name of the file, for messages.
        separator: Separator of the cells.
        names: Index of the column of each element's joint name.
        fields: Indices of the columns of each further field, element by element.
        order: Names of the joints in the first row, which the header's columns follow.
        required: Names of the joints that a row must hold.
    """

    source: str
    separator: str
    names: Sequence[int]
    fields: Sequence[Sequence[int]]
    order: Sequence[str]
    required: Sequence[str]

    def rewrite(self, text: bytes) -> tuple[bytes, int]:
        """Permute the elements of rows that list their joints in another order.

        Rows that lack one of the robot's joints, as those of a gripper, are left out.
        """
        lines = text.split(b"\n")
        first = next((line for line in lines if line.strip()), b"")
        names = self._names(_cells(first, self.separator))
        if names == list(self.order) and self._is_uniform(text, first, len(lines)):
            return text, 0
        kept, left_out = list[str](), 0
        for row in _rows(text, self.separator):
            names = self._names(row)
            if not set(self.required) <= set(names):
                left_out += 1
                continue
            place = {name: k for k, name in enumerate(names)}
            cells = list(row)
            for field in self.fields:
                for k, name in enumerate(self.order):
                    known = name in place and place[name] < len(field)
                    cells[field[k]] = row[field[place[name]]] if known else ""
            kept.append(self.separator.join(f'"{cell}"' if "," in cell else cell for cell in cells))
        return ("\n".join(kept) + "\n").encode() if kept else b"", left_out

    def _names(self, row: Sequence[str]) -> list[str]:
        """Names of the joints in a row."""
        return [row[k].strip().strip("\"'") for k in self.names if k < len(row)]

    def _is_uniform(self, text: bytes, first: bytes, lines: int) -> bool:
        """Return True if all rows have the name cells of the first row, one after another."""
        if list(self.names) != list(range(self.names[0], self.names[0] + len(self.names))):
            return False
        cells = first.split(self.separator.encode())
        joined = self.separator.encode().join(cells[self.names[0] : self.names[-1] + 1])
        return text.count(joined) >= lines - 1


@dataclass(frozen=True)
class ListCells:
    """Columns whose cells hold a list with an element per joint.

    Attributes:
        source: Name of the file, for messages.
        separator: Separator of the cells.
        time: Indices of the columns of time.
        names: Index of the column with the names of the joints; None: the robot's order.
        fields: Index of the column of each quantity.
        joints: Names of the robot's joints, which is the order of the columns that are written.
        locked: Names of locked joints, whose positions are written behind.
    """

    source: str
    separator: str
    time: Sequence[int]
    names: int | None
    fields: Mapping[str, int]
    joints: Sequence[str]
    locked: Sequence[str] = ()

    def rewrite(self, text: bytes) -> tuple[bytes, int]:
        """Write the elements of the robot's joints into columns of their own.

        Raises:
            UnusableInput: A list has another number of elements than there are joints.
        """
        kept, left_out = list[str](), 0
        for row in _rows(text, self.separator):
            width = max((*self.time, *self.fields.values(), self.names or 0)) + 1
            names = list(self.joints)
            if self.names is not None and len(row) >= width:
                names = [name.strip("\"'") for name in _elements(row[self.names])]
            if len(row) < width or not set(self.joints) <= set(names):
                left_out += 1
                continue
            cells, behind = [row[k] for k in self.time], list[str]()
            for quantity, column in self.fields.items():
                values = _elements(row[column])
                if values and len(values) != len(names):
                    raise UnusableInput(
                        f"{self.source}: {len(values)} values of {quantity} for {len(names)} "
                        f"joints ({', '.join(names)}) at time {row[self.time[0]]}; correct the row"
                    )
                place = dict(zip(names, values, strict=False))
                cells += [place.get(joint, "") for joint in self.joints]
                if quantity == "q":
                    behind = [place.get(joint, "") for joint in self.locked]
            kept.append(self.separator.join([*cells, *behind]))
        return ("\n".join(kept) + "\n").encode() if kept else b"", left_out


def is_list(cell: str) -> bool:
    """Return True for a cell that holds a list, such as `[0.1, 0.2]`."""
    return cell.strip().startswith(("[", "(", "{"))


def _elements(cell: str) -> list[str]:
    """Elements of a list in a cell, separated by commas, semicolons or blanks."""
    inner = cell.strip(BRACKETS).replace(";", ",")
    parts = inner.split(",") if "," in inner else inner.split()
    return [part.strip() for part in parts if part.strip()]


def _rows(text: bytes, separator: str) -> list[list[str]]:
    """Rows of a CSV that are not empty."""
    reader = csv.reader(io.StringIO(text.decode("utf-8")), delimiter=separator)
    return [row for row in reader if row]


def _cells(line: bytes, separator: str) -> list[str]:
    """Cells of a line."""
    return next(csv.reader([line.decode("utf-8")], delimiter=separator), [])

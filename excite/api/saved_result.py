"""Results of commands that are several files in a folder, one of them a report."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from .._system.output_files import output_files, output_folder


@dataclass(frozen=True)
class SavedResult(ABC):
    """A result that is saved as several files, with a report as HTML.

    Attributes:
        FILES: Names of the files that `save` owns in its folder.
        inputs: Files that the result was computed from, which `save` and `report` do not replace.
    """

    FILES: ClassVar[tuple[str, ...]]
    inputs: tuple[Path, ...] = field(default=(), repr=False, kw_only=True)

    @abstractmethod
    def contents(self) -> Mapping[str, str]:
        """Return the files by name, relative to their folder."""

    @abstractmethod
    def html(self) -> str:
        """Return the report as HTML."""

    def save(self, folder: str | Path) -> list[Path]:
        """Write the files named in `contents`; return their paths.

        Raises:
            UnusableInput: The files cannot be written, or one is among `inputs`.
        """
        output = output_folder(Path(folder), self.FILES, self.inputs)
        return output.replace(self.contents())

    def report(self, path: str | Path) -> Path:
        """Write the report alone; return its path.

        Raises:
            UnusableInput: The file cannot be written, or is among `inputs`.
        """
        path = Path(path)
        return output_files(path, inputs=self.inputs).replace({path.name: self.html()})[0]

"""Results of an identification: a model, the robot as a URDF, and a report."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .. import _json
from ..recordings import Recording
from ..recordings.remark import Remark
from .saved_result import SavedResult
from .stated_recordings import remarks_by_recording

IDENTIFICATION_FILES = ("model.json", "identified.urdf", "report.html")
"""Files of an identification."""


@dataclass(frozen=True)
class SavedIdentification(SavedResult):
    """An identified robot.

    Attributes:
        identification: Parameters with their model, and predictions.
        recordings: Recordings that the model is fitted to.
        validation: Held-out recordings.
    """

    FILES = IDENTIFICATION_FILES

    identification: Any
    recordings: tuple[Recording, ...]
    validation: tuple[Recording, ...]

    @property
    def parameters(self) -> dict[str, float]:
        """Identified standard parameters by name, in SI units."""
        result = self.identification
        return dict(zip(result.model.parameters.names, result.psi.tolist(), strict=True))

    @property
    def remarks(self) -> dict[str, list[Remark]]:
        """Remarks of the data-quality checks, by the name of their recording."""
        return remarks_by_recording([*self.recordings, *self.validation])

    @abstractmethod
    def document(self) -> dict[str, Any]:
        """Return the content of `model.json`."""

    def contents(self, document: Mapping[str, Any] | None = None) -> dict[str, str]:
        """Return the files of the identification by name.

        Args:
            document: Content of `model.json`; None: it is computed.
        """
        document = self.document() if document is None else document
        return {
            "model.json": _json.dumps(document),
            "identified.urdf": str(document["urdf"]),
            "report.html": self.html(),
        }

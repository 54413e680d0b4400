"""Check of a saved model: its errors on recordings, computed from the file's content alone."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import _json
from .._types import FloatArray
from ..effects.recorded_motion import RecordedMotion
from ..identification import identified_model
from ..identification.identified_model import IdentifiedModel
from ..recordings import Recording
from . import fitted_effects


def read_back(document: Mapping[str, Any]) -> IdentifiedModel:
    """Return the model that `excite predict` reads from the text of a `model.json`.

    Args:
        document: Content of the file.
    """
    file = identified_model.model_file(Path("model.json"))
    return identified_model.model_from_document(file, json.loads(_json.dumps(document)))


def residuals(
    model: IdentifiedModel,
    recordings: Sequence[Recording],
    motions: Sequence[RecordedMotion],
) -> FloatArray:
    """Return measured minus predicted torque at the rows of motions, shape (N, n) [N m].

    Args:
        model: A model.
        recordings: The recordings in which the motions lie.
        motions: The motions, with the measured torque below the cutoff frequency.
    """
    predictions = {r.source: fitted_effects.predict(model, r) for r in recordings}
    out = []
    for motion in motions:
        times, torque = predictions[motion.segment.source]
        at_rows = [np.interp(motion.time, times, column) for column in torque.T]
        out.append(motion.torque - np.column_stack(at_rows))
    return np.concatenate(out)

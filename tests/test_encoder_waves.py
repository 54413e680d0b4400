"""Encoder errors of high order, as of the encoder of a geared motor."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from diagnosis_cases import diagnose, findings_of, noise_ratios, parameters, recordings_of

from excite.recordings import Recording

ORDER, AMPLITUDE = 40.0, 3e-4
"""Order [1/turn] and amplitude [rad] of the error."""


def misread(recording: Recording) -> Recording:
    """Return a recording whose second encoder has a periodic error."""
    q = recording.q.copy()
    q[:, 1] += AMPLITUDE * np.sin(ORDER * q[:, 1] + 0.4)
    return dataclasses.replace(recording, q=q)


@pytest.mark.slow
def test_encoder_error_of_high_order_is_no_ripple():
    result = diagnose([misread(recording) for recording in recordings_of(None, (2, 5, 8))])
    assert findings_of(result) == [("encoder_error", 1)]
    estimates = parameters(result, "encoder_error", 1)
    np.testing.assert_allclose(estimates["order"][0], ORDER, rtol=0.01)
    np.testing.assert_allclose(estimates["amplitude"][0], AMPLITUDE, rtol=0.1)
    before, after = noise_ratios(result)
    assert before[1] > 2.0 and (after < 1.3).all()

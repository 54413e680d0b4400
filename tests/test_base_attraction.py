"""Attraction of a base model with effects to the base model that is fitted alone."""

from __future__ import annotations

import numpy as np
import pytest

from excite.diagnosis import base_attraction, joint_model
from excite.diagnosis.joint_model import JointModel
from excite.diagnosis.regression import JointRegression
from excite.effects import recorded_motion
from excite.identification import identification, segments
from excite.identification.identification import Identification, IdentificationOptions
from tests.diagnosis_cases import SUBJECT, at_joint, recordings_of

BAND = 12.0


def base_model(added: float) -> tuple[Identification, JointModel]:
    """Return a robot whose elbow has a torque of unknown form, and its joint model without effects.

    Args:
        added: Amplitude of that torque [N m].
    """
    recordings = recordings_of(lambda t, q, dq, tau: at_joint(1, added * np.sin(5.0 * q[:, 1])))
    identified = identification.identify(
        SUBJECT.robot,
        SUBJECT.parameters,
        SUBJECT.base,
        recordings,
        (),
        IdentificationOptions(band=BAND),
    )
    psi = joint_model.initial_parameters(identified)
    motions = recorded_motion.recorded_motions(
        identified.model,
        recorded_motion.fitted_robot(SUBJECT.robot, SUBJECT.parameters, psi),
        SUBJECT.base.matrix @ psi,
        list(segments.extract_segments(recordings, average=False)),
        BAND,
    )
    model = joint_model.fit(identified, motions).keeping(())
    model.regression.fix_at_zero(range(len(model.free), model.delay_place + 1))
    return identified, model


def shoulder_error(regression: JointRegression) -> float:
    """RMS residual of the shoulder [N m]."""
    return float(regression.residual_rms(regression.solution)[0])


@pytest.mark.parametrize("added", [0.0, 0.3])
def test_weights_that_spoil_no_joint_are_kept(added):
    identified, model = base_model(added)
    joint_model.reweight(model.regression)
    prior = model.regression.prior_matrix.copy()
    base_attraction.attract(identified, model)
    np.testing.assert_array_equal(model.regression.prior_matrix, prior)


def test_a_joint_that_another_one_spoils_keeps_its_base_model():
    identified, model = base_model(added=2.0)
    joint_model.reweight(model.regression)
    fair = shoulder_error(model.regression)
    sigma = model.regression.sigma * [1.0, 0.03]  # as if effects explained the elbow
    model.regression.reweighted(sigma, model.regression.independent_share)
    spoilt = shoulder_error(model.regression)
    assert spoilt > 1.5 * fair
    base_attraction.attract(identified, model)
    assert shoulder_error(model.regression) < fair + 0.5 * (spoilt - fair)

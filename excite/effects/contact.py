"""Contact: an external force on a link for some of the time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from .._types import FloatArray
from ..identification.lowpass import Grid
from .effect import CandidateModel, Effect, NonlinearParameter, Values
from .recorded_motion import FittedRobot, Motions, RecordedMotion

COURSES = ((1.0, 0.0, 0.0), (1.348, 1.0, 0.0), (1.6, 0.0, 8.0))
"""Time courses of the force that are tried, each (stretch, swells, knots).

Length of the interval over that of the constant force that explains most of it [1]: for half a sine
that which maximises (∫ sin)²/length, for a piecewise linear course 0.3 on either side to rise and
fall; 1 if the force rises and falls as half a sine, 0 if it is constant; number of knots of a
piecewise linear course, 0 for the other two. Forms of the model, no bounds on a score.
"""
MAX_SHARE = 0.5
"""Length of the longest contact over that of its motion, and rows of a joint during it over all
rows of the joint [1], the bound of its prior: the joint model without the contact is known from the
rest, which is not to be the smaller part."""
END_FACTOR = 1.5
"""Largest factor by which a search for one end changes the length of an interval [1]: windows are a
factor of two apart, so that the true length is within √2 of one. The range of a search."""


class _Contact(Effect):
    """Torque −Jᵀ f of a force f, in the base frame, on a link's centre of mass in an interval."""

    def torque_columns(self, motion: RecordedMotion, model: CandidateModel) -> FloatArray:
        course = _course(motion, model)
        if not course.any():
            return np.zeros((len(motion), motion.n, 3 * course.shape[1]))
        torque = -np.einsum("tk,txj->tjkx", course, motion.link_jacobians[:, model.joint_index])
        return motion.lowpass(torque.reshape(*torque.shape[:2], -1), Grid.COARSE)

    def parameters(self, model: CandidateModel, c: FloatArray, base: FittedRobot) -> Values:
        """Return the largest force of the course [N]."""
        return {"force": float(np.linalg.norm(c.reshape(-1, 3), axis=1).max())}

    def is_plausible(self, model: CandidateModel, c: FloatArray) -> bool:
        """Tell whether most rows that show it are of joints that other rows show as well.

        A joint that moves during the contact alone has no other rows: whatever its model lacks
        would be a contact, as where the joints of a robot move one after the other.
        """
        acting = model.motions[0].link_jacobians[:, model.joint_index].any(axis=(0, 1))
        total, within = np.zeros((2, model.motions[0].n))
        for motion in model.motions:
            total += motion.moving.sum(axis=0)
            within += (motion.moving & model.acts_during(motion)[:, None]).sum(axis=0)
        known = acting & (within <= MAX_SHARE * model.facts["stretch"] * total)
        return bool(within[known].sum() >= 0.5 * within[acting].sum())

    def varied(self, model: CandidateModel, key: str, value: float) -> CandidateModel:
        """Return the model with an interval of another length [s], whose `key` end is free."""
        assert model.interval is not None
        low, high = model.interval
        interval = (high - value, high) if key == "begin" else (low, low + value)
        return replace(model, interval=interval)

    def variants(self, model: CandidateModel) -> list[NonlinearParameter]:
        """Move the other end."""
        assert model.nonlinear is not None
        return [_free_end(model, "end" if model.nonlinear.key == "begin" else "begin")]


def _course(motion: RecordedMotion, model: CandidateModel) -> FloatArray:
    """Return the basis functions of the force over time, at the coarse samples. Shape (C, k)."""
    assert model.interval is not None
    low, high = model.interval
    rate = motion.band.rate_of(Grid.COARSE)
    time = motion.segment.start + np.arange(len(motion.coarse_samples)) / rate
    u = (time - low) / (high - low)
    inside = (u > 0.0) & (u < 1.0) & (motion.segment.source == model.source)
    if not model.values["knots"]:
        return np.where(inside, np.sin(np.pi * u) if model.values["swells"] else 1.0, 0.0)[:, None]
    count = int(model.values["knots"])
    hats = np.maximum(1.0 - np.abs((count + 1.0) * u[:, None] - np.arange(1, count + 1)), 0.0)
    return hats * (motion.segment.source == model.source)


def unit_forces(motion: RecordedMotion) -> FloatArray:
    """Return the torque of unit forces on the links' centres of mass, shape (N, links, n, 3)."""
    return motion.lowpass(-np.swapaxes(motion.link_jacobians, 2, 3), Grid.COARSE)


def contact_models(
    motions: Motions, number: int, low: float, high: float, alternatives: float
) -> Iterator[CandidateModel]:
    """Yield forces on every link from `low` to `high` [s] of a motion.

    `alternatives` is the number of intervals of which this was chosen.
    """
    for stretch, swells, knots in COURSES:
        margin = 0.5 * (stretch - 1.0) * (high - low)
        for joint in range(motions[number].n):
            model = CandidateModel(
                CONTACT,
                joint,
                {"swells": swells, "knots": knots},
                interval=(low - margin, high + margin),
                source=motions[number].segment.source,
                facts={"stretch": stretch},
                motions=motions,
                alternatives=alternatives,
            )
            yield _free_end(model, "begin").current


def _free_end(model: CandidateModel, end: str) -> NonlinearParameter:
    """Return the length of an interval of which one end is free: its "begin" or "end"."""
    assert model.interval is not None
    length = model.interval[1] - model.interval[0]
    model = replace(model, nonlinear=None)
    return NonlinearParameter(model, end, length, length / END_FACTOR, length * END_FACTOR)


CONTACT = _Contact(
    "contact",
    "Jᵀ f on an interval",
    {"force": "N"},
    "for some of the time only, in the joints before the contact",
    "the same motion without anything near the robot",
    regime="time",
    has_candidates=False,
    form_std={"force": 0.1},
    of_link=True,
)
"""Collision or contact with the environment or a person."""

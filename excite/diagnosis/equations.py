"""Equations of a diagnosis: both folds with the base model, and the columns of the candidates."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from .._types import FloatArray
from ..effects import EFFECTS, EFFECTS_BY_NAME
from ..effects.effect import CandidateModel
from ..effects.recorded_motion import RecordedMotion
from ..identification import consistency
from ..identification.identification import Identification
from . import search, session_changes
from .columns import Columns
from .half import Half, whitened
from .session_changes import Halves

ROOM = 400_000_000
"""For columns that are kept [bytes]."""


def kept(psi: FloatArray, trusted: Mapping[int, float]) -> FloatArray:
    """Return parameters with those of a trusted prior unchanged, as a fit would distort them."""
    out = psi.copy()
    for place, value in trusted.items():
        out[place] = value
    return out


def half(
    tracks: list[RecordedMotion],
    identified: Identification,
    trusted: Mapping[int, float],
    scale: FloatArray,
    differing: Halves | None = None,
) -> Half:
    """Return the whitened equations of a fold: all base parameters, or those that a prior leaves
    free.

    Args:
        tracks: Motions of the fold.
        identified: The base model.
        trusted: Values of a trusted prior by parameter index.
        scale: Scale of each joint's torque, shape (n,).
        differing: Motions of both folds, if actuator parameters differ between recordings.
    """
    base, parameters = identified.model.base, identified.model.parameters
    places = np.arange(base.count)
    if trusted:
        drives = 10 * parameters.bodies
        places = np.array(
            [
                k
                for k, place in enumerate(base.independent)
                if place >= drives and int(place) not in trusted
            ],
            int,
        )
    columns, torque = [], []
    for one in tracks:
        slopes = np.zeros((len(one), one.n, one.n))
        slopes[:, range(one.n), range(one.n)] = one.slopes
        own = [session_changes.columns(one, differing)] if differing else []
        columns.append(np.concatenate([one.gamma[:, :, places], *own, slopes], axis=2))
        torque.append(one.residual if trusted else one.torque)
    rows, right = _known(identified, trusted, columns[0].shape[2])
    if differing:
        std = session_changes.prior_std([*differing[0], *differing[1]])
        changes = np.zeros((len(std), rows.shape[1]))
        changes[:, len(places) : len(places) + len(std)] = np.diag(1.0 / std)
        rows, right = np.vstack([rows, changes]), np.concatenate([right, np.zeros(len(std))])
    return whitened(columns, torque, [one.moving for one in tracks], scale, (rows, right))


def _known(
    identified: Identification, trusted: Mapping[int, float], width: int
) -> tuple[FloatArray, FloatArray]:
    """Prior of the base parameters as rows: a short recording alone would not predict another."""
    n = identified.model.robot.n
    slopes = np.hstack(
        [np.zeros((n, width - n)), np.eye(n)]
    )  # friction's width is known within a factor e: what is linear is no further
    if trusted:
        return slopes, np.zeros(n)
    base, prior = identified.model.base, identified.prior
    values, vectors = np.linalg.eigh(
        consistency.base_prior_information(identified.model.parameters, base, prior)
    )
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    rows = np.zeros((base.count, width))
    rows[:, : base.count] = root
    return np.vstack([rows, slopes]), np.concatenate(
        [root @ (base.matrix @ prior.nominal), np.zeros(n)]
    )


def shapes(
    halves: Sequence[list[RecordedMotion]],
    trusted: bool,
    floor: FloatArray,
    names: Collection[str] = (),
) -> list[CandidateModel]:
    """Return all candidate models of the wanted effects that the noise permits.

    Args:
        halves: Motions of both folds.
        trusted: Whether a prior is trusted.
        floor: Noise floor [N m], shape (n,).
        names: Names of the wanted effects; all when empty.
    """
    every = [*halves[0], *halves[1]]
    wanted = [
        effect
        for effect in EFFECTS
        if (trusted or not effect.prior_only) and effect.name in (names or EFFECTS_BY_NAME)
    ]
    grain = floor / np.maximum(
        np.sqrt(np.mean(np.concatenate([one.torque for one in every]) ** 2, axis=0)), 1e-300
    )
    every_shape = (shape for effect in wanted for shape in effect.candidates(every))
    return [
        shape
        for shape in every_shape
        if shape.joint is None or grain[shape.joint] <= shape.max_noise_ratio
    ]


def builder(
    halves: Sequence[list[RecordedMotion]], scale: FloatArray, listed: Sequence[CandidateModel] = ()
) -> search.Build:
    """Return a function that builds a candidate model's columns on both folds, over the scale.

    Columns of the models in `listed`, which are needed again, are kept as far as memory permits.
    """
    again, made, room = (
        {search.key(shape) for shape in listed},
        dict[tuple[object, ...], tuple[Columns, Columns] | None](),
        ROOM,
    )

    def build(shape: CandidateModel) -> tuple[Columns, Columns] | None:
        nonlocal room
        key = search.key(shape)
        if key in made:
            return made[key]
        out = make(shape)
        size = 0 if out is None else sum(own.nbytes for own in out)
        if key in again and size <= room:
            made[key], room = out, room - size
        return out

    def make(shape: CandidateModel) -> tuple[Columns, Columns] | None:
        first, second = (
            Columns.of(
                np.concatenate(
                    [shape.columns(one) * one.moving[:, :, None] / scale[:, None] for one in own]
                )
            )
            for own in halves
        )
        every = [*first.values, *second.values]
        if not all(np.isfinite(x).all() for x in every) or not any(
            np.abs(x).max(initial=0.0) > 1e-9 for x in every
        ):
            return None
        return first, second

    return build

#!/usr/bin/env python
"""Cross-validate the prior of `excite identify` on the training recordings of real machines.

Each part of the training recordings is predicted with parameters fitted to the others: by ordinary
least squares, and with the prior whose weights maximise the evidence. The parts are the recordings
themselves, and five contiguous blocks. The friction widths and the cutoff frequency are those of
all training recordings; the held-out recordings of `held_out_errors.py` are not read.

    python scripts/prior_cross_validation.py --data DIR [--only XL330]
"""

from __future__ import annotations

import argparse
import itertools
import warnings
from pathlib import Path

import numpy as np
from held_out_errors import DATA_SETS

from excite import api
from excite._types import FloatArray
from excite.identification import consistency, estimators, identification, prior_weight
from excite.identification.consistency import Prior
from excite.identification.estimators import Method
from excite.identification.identification import Identification
from excite.identification.regression import TorqueEquations

BLOCKS = 5
"""Number of contiguous blocks."""


def cross_validated(result: Identification, edges: FloatArray) -> tuple[float, float]:
    """Return the relative errors of least squares and of the estimate with the prior.

    Args:
        result: Identification from all parts.
        edges: Rows at which parts begin, and the number of rows. Shape (parts + 1,).
    """
    rows = np.arange(len(result.equations))
    ordinary = identified = size = 0.0
    for low, high in itertools.pairwise(edges):
        training = result.equations.rows(np.flatnonzero((rows < low) | (rows >= high)))
        part = result.equations.rows(slice(int(low), int(high)))
        theta = np.linalg.lstsq(
            training.regressor.reshape(-1, training.regressor.shape[2]),
            training.torque.ravel(),
            rcond=None,
        )[0]
        ordinary += squared_error(part, theta)
        identified += squared_error(part, with_prior(result, training))
        size += float(np.sum(part.torque**2))
    return (ordinary / size) ** 0.5, (identified / size) ** 0.5


def squared_error(part: TorqueEquations, theta: FloatArray) -> float:
    """Return the squared torque error of base parameters."""
    return float(np.sum((part.torque - part.predicted(theta)) ** 2))


def with_prior(result: Identification, training: TorqueEquations) -> FloatArray:
    """Return base parameters fitted to a part of the equations, with the prior by evidence."""
    parameters, base = result.model.parameters, result.model.base
    data = estimators.estimate(
        training, Method.WLS, nuisance=identification.width_slopes(result.model, training)
    )
    root, target = data.information_root @ base.matrix, data.information_root @ data.theta
    count = parameters.count - 10 * parameters.bodies
    start = Prior(
        result.prior.nominal, result.prior.distance, 1.0, np.ones(count), result.prior.joint_scales
    )
    inertial, joint = prior_weight.gamma_by_evidence(parameters, root, target, start)
    prior = Prior(start.nominal, start.distance, inertial, joint, start.joint_scales)
    psi = consistency.maximum_a_posteriori(parameters, root, target, prior).psi
    return np.asarray(base.matrix @ psi)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True, help="folder of the recordings")
    parser.add_argument("--only", nargs="*", default=list(DATA_SETS), choices=list(DATA_SETS))
    arguments = parser.parse_args()
    print("| training recordings of | left out | least squares | excite identify |")
    print("|---|---|---:|---:|")
    for name in arguments.only:
        data = DATA_SETS[name]
        urdf = arguments.data / data.robot
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = api.identify(urdf, [urdf.parent / f"{n}.csv" for n in data.train])
        equations = result.identification.equations
        parts = {"a block of five": np.linspace(0, len(equations), BLOCKS + 1).astype(int)}
        if len(equations.starts) > 1:
            parts["a recording"] = np.array([*equations.starts, len(equations)])
        for words, edges in parts.items():
            ordinary, identified = cross_validated(result.identification, edges)
            print(
                f"| {name} | {words} | {100.0 * ordinary:.1f} % | {100.0 * identified:.1f} % |",
                flush=True,
            )


if __name__ == "__main__":
    main()

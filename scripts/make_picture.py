"""Draw the README's figures: a designed motion with its information, and a torque budget."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from excite.cli import main as main_module
from excite.designer import certificate, identifiability
from excite.robot import base_parameters
from excite.robot.dynamics import band, regressor
from excite.trajectory import trajectory_file

FOLDER = Path(__file__).resolve().parent.parent
REAL_RECORDINGS = Path(os.environ.get("EXCITE_RECORDINGS", FOLDER.parent / "shared" / "recordings"))
JOINTS = 3
"""Joints that the first figure shows."""


def main() -> None:
    """Draw both figures."""
    draw_design()
    if REAL_RECORDINGS.is_dir():
        draw_torque_budget(REAL_RECORDINGS / "tx40")
    else:
        sys.exit(
            f"{REAL_RECORDINGS}: no recordings, so the torque budget was not drawn; "
            "set EXCITE_RECORDINGS to their folder"
        )


def draw_torque_budget(folder: Path) -> None:
    """Write the torque budget of a robot, as in the report of `excite diagnose`, to a file."""
    with tempfile.TemporaryDirectory() as out:
        robot, train, held_out = (
            str(folder / name) for name in (f"{folder.name}.urdf", "train.csv", "validate.csv")
        )
        if main_module.main(["diagnose", robot, train, "--validate", held_out, "-o", out]):
            sys.exit(1)
        page = (Path(out) / "report.html").read_text()
    match = re.search(
        r'<svg viewBox="0 0 (\S+) (\S+)" role="img" '
        r'aria-label="Torque budget of every joint".*?</svg>',
        page,
        re.DOTALL,
    )
    if match is None:
        sys.exit(f"{folder}: the report has no torque budget")
    white = f'<rect width="{match[1]}" height="{match[2]}" fill="#fff"/>'
    head, body = match[0].split(">", 1)
    (FOLDER / "notebooks" / f"{folder.name}_budget.svg").write_text(
        f'{head} xmlns="http://www.w3.org/2000/svg">{white}{body}\n'
    )


def draw_design() -> None:
    """Draw a designed motion within its limits, and the variance of each direction."""
    trajectory = trajectory_file.read_trajectory(FOLDER / "trajectories" / "ur10e.json")
    robot = trajectory.load_robot()
    subject = certificate.motion_constraints(trajectory, robot, trajectory.limits)
    parameters, motion, limits = subject.parameters, trajectory.motion, trajectory.limits
    t = motion.grid(trajectory.rate)
    samples = motion.samples(t)
    nominal, width = band(regressor(robot, parameters, samples), parameters, subject.uncertainty)
    base = base_parameters.find(robot, parameters, limits)
    root = identifiability.information_root(robot, parameters, samples, trajectory.noise)
    analysis = identifiability.analyse_root(parameters, base, root, trajectory.noise, robot)

    figure = Figure(figsize=(11, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subfigures(1, 2, width_ratios=(1.5, 1.0))
    axes = left.subplots(JOINTS, 2, sharex=True)
    for j in range(JOINTS):
        for axis, curve, bound in (
            (axes[j, 0], samples.dq, limits.velocity[j]),
            (axes[j, 1], nominal, limits.torque[j]),
        ):
            axis.plot(t, curve[:, j], color="#1f5f9e", linewidth=1)
            for sign in (-1, 1):
                axis.axhline(sign * bound, color="#b03030", linestyle="--", linewidth=0.8)
            axis.spines[["top", "right"]].set_visible(False)
            axis.tick_params(labelsize=8)
        axes[j, 1].fill_between(
            t,
            nominal[:, j] - width[:, j],
            nominal[:, j] + width[:, j],
            color="#1f5f9e",
            alpha=0.25,
            linewidth=0,
        )
        axes[j, 0].set_ylabel(robot.joints[j].removesuffix("_joint").replace("_", " "), fontsize=9)
    axes[0, 0].set_title("velocity [rad/s] and its limits", fontsize=10)
    axes[0, 1].set_title("torque [N m] of every robot nearby", fontsize=10)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]", fontsize=9)

    axis = right.subplots()
    variances = np.array([d.variance for d in analysis.directions])
    order = np.argsort(variances)
    identifiable = variances[order] <= analysis.threshold
    places = np.arange(1, len(order) + 1)
    for mask, color, text in (
        (identifiable, "#1d7d46", "identifiable"),
        (~identifiable, "#b03030", "not with this motion"),
    ):
        axis.semilogy(
            places[mask],
            variances[order][mask],
            "o",
            markersize=4,
            color=color,
            label=f"{text} ({mask.sum()})",
        )
    axis.axhline(analysis.threshold, color="0.3", linestyle="--", linewidth=1)
    axis.set_title("how well each direction of the parameters is seen", fontsize=10)
    axis.set(xlabel="direction", ylabel="scale-free variance 1/λ")
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False, fontsize=9)
    figure.savefig(FOLDER / "notebooks" / "ur10e.png", dpi=110)


if __name__ == "__main__":
    main()

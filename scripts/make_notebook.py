"""Write `notebooks/first_trajectory.ipynb`: cells as text here, so that changes can be read in a diff."""

from __future__ import annotations

from pathlib import Path

import nbformat

CELLS = [
    (
        "markdown",
        """# A first excitation trajectory

From a robot to a motion that shows its inertial parameters, step by step, with the Python package.
Run from the repository's `notebooks/` folder after `scripts/excite robots` has installed everything.""",
    ),
    (
        "code",
        """import numpy as np
from IPython.display import display
from matplotlib.figure import Figure

from excite import base, criteria, dynamics, limits, parameters, robot, workflow
from excite.criteria import Criterion
from excite.problem import Options""",
    ),
    (
        "markdown",
        """## What can be seen at all

Not every inertial parameter acts on the joint torques. What does are the *base parameters* θ = Bψ.""",
    ),
    (
        "code",
        """arm = robot.load("two_link")
bounds = limits.resolve(arm)
psi = parameters.standard(arm, bounds)
theta = base.find(arm, psi, bounds)
print(f"{psi.count} standard parameters, {theta.count} base parameters")
for name, expression in zip(np.array(psi.names)[theta.independent], theta.expressions, strict=True):
    print(f"  {name:6} = {expression}")""",
    ),
    (
        "markdown",
        """## A motion that shows them

`workflow.run` optimises a Fourier series, adds ramps, and certifies the whole motion. Here for A-optimality in the metric
of physically consistent parameters, and for D-optimality.""",
    ),
    (
        "code",
        """results = {c: workflow.run(arm, bounds, Options(criterion=c, starts=1)) for c in (Criterion.A, Criterion.D)}
for criterion, delivery in results.items():
    scores = delivery.trajectory.criteria["optimum"]["geometric"]
    worst = delivery.certificate.worst()
    print(criterion.name, {k: float(f"{v:.4g}") for k, v in scores.items()}, "certified:", delivery.certificate.ok,
          f"| nearest limit: {worst.limit} of {worst.joint}, {100 * worst.room:.2f} % left")""",
    ),
    (
        "code",
        """figure = Figure(figsize=(9, 4), layout="constrained")
axes = figure.subplots(2, 2, sharex=True)
for column, (criterion, delivery) in enumerate(results.items()):
    motion = delivery.trajectory.motion
    t = motion.grid(100.0)
    axes[0, column].plot(t, motion.at(t), label=list(arm.joints))
    axes[0, column].set(title=f"designed for {criterion.name}", ylabel="position [rad]")
    Y = dynamics.regressor(arm, psi, motion.samples(t))
    axes[1, column].plot(t, Y @ psi.nominal)
    axes[1, column].set(xlabel="time [s]", ylabel="torque [N m]")
axes[0, 0].legend(frameon=False)
display(figure)""",
    ),
    (
        "markdown",
        """## What it will tell

The eigenvalues of I·H₀⁻¹ are scale-free: 1/λ is the variance of its direction relative to the nominal robot, whatever the
units and frames. Below 0.01 (a standard deviation of about 10 %) a direction counts as practically identifiable.""",
    ),
    (
        "code",
        """figure = Figure(figsize=(7, 3.2), layout="constrained")
axis = figure.subplots()
for criterion, delivery in results.items():
    motion = delivery.trajectory.motion
    rows = criteria.weighting(Criterion.A, theta, delivery.trajectory.noise, plain=False)
    samples = motion.samples(motion.grid(100.0))
    eigenvalues = len(samples) * criteria.spectrum(rows.rows(dynamics.regressor(arm, psi, samples)))
    axis.semilogy(np.sort(1.0 / eigenvalues), "o-", label=f"designed for {criterion.name}")
axis.axhline(1e-2, color="0.4", linestyle="--", linewidth=1)
axis.set(xlabel="direction", ylabel="scale-free variance 1/λ")
axis.legend(frameon=False)
display(figure)""",
    ),
    (
        "markdown",
        """The command line does all of this at once and writes the files a controller takes:

```
scripts/excite design two_link -o out/two_link
scripts/excite export out/two_link/trajectory.json --format ros2-joint-trajectory -o two_link.yaml
```""",
    ),
]


def main() -> None:
    notebook = nbformat.v4.new_notebook()
    for number, (kind, text) in enumerate(CELLS):
        cell = nbformat.v4.new_markdown_cell(text) if kind == "markdown" else nbformat.v4.new_code_cell(text)
        cell["id"] = f"cell-{number}"
        notebook.cells.append(cell)
    target = Path(__file__).resolve().parent.parent / "notebooks" / "first_trajectory.ipynb"
    nbformat.write(notebook, target)


if __name__ == "__main__":
    main()

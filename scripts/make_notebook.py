"""Write the notebooks: cells as text here, so that changes can be read in a diff."""

from __future__ import annotations

from pathlib import Path

import nbformat

FIRST_TRAJECTORY = [
    (
        "markdown",
        """# A first excitation trajectory

From a robot to a motion that shows its inertial parameters, step by step, with the Python package.
Run from the repository's `notebooks/` folder after `scripts/excite robots` has installed everything.""",
    ),
    (
        "code",
        """%matplotlib inline
import numpy as np
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
    print(
        criterion.name,
        {k: float(f"{v:.4g}") for k, v in scores.items()},
        "certified:",
        delivery.certificate.ok,
        f"| nearest limit: {worst.limit} of {worst.joint}, {100 * worst.room:.2f} % left",
    )""",
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

IDENTIFY_AND_DESIGN_AGAIN = [
    (
        "markdown",
        """# From recordings to parameters, and what to record next

Design a motion, record a robot that follows it, identify the robot, and let what is still unknown decide the next motion.
The robot here is simulated by `excite.plant` (`pip install 'excite[trial]'`), which shares no code with the estimator: its
bodies are about 5 % off the URDF, its friction, rotor inertia and offsets are in no file. Record your own instead where you have one.""",
    ),
    (
        "code",
        """%matplotlib inline
import json
import tempfile
from pathlib import Path

import numpy as np
from IPython.display import display
from matplotlib.figure import Figure

from excite import artefact, base, limits, parameters, recordings, robot, workflow
from excite.identify import identification
from excite.plant import laboratory
from excite.problem import Options

arm = robot.load("ur10e")
bounds = limits.resolve(arm)
psi = parameters.standard(arm, bounds)
theta = base.find(arm, psi, bounds)
folder = Path(tempfile.mkdtemp())""",
    ),
    (
        "markdown",
        """## Design and record

Two motions: one to fit, one of another seed to judge the model by. Short searches, so that this page runs in seconds.
Three periods each: the first half second is left out until the loop has settled, and a noise floor takes two whole ones. A recording is a
CSV of `t`, `q.<joint>` and `tau.<joint>`; the `.json` beside it says after what time the motion repeats.""",
    ),
    (
        "code",
        """def design(name, given=None, **options):
    delivery = workflow.run(arm, bounds, Options(period=5.0, periods=3, starts=1, iterations=40, **options), given=given)
    (folder / f"{name}.json").write_text(artefact.dumps(delivery.trajectory.document()))
    print(f"{name}: {delivery.trajectory.motion.duration:.1f} s, certified: {delivery.certificate.ok}")


def record(name):
    setting = laboratory.Setting(seed=3, rate=250.0)
    measured = laboratory.simulate(robot.locate("ur10e"), folder / f"{name}.json", setting).recording
    (folder / f"{name}_recorded.csv").write_text(measured.csv())
    (folder / f"{name}_recorded.json").write_text(json.dumps(measured.sidecar()))
    return recordings.read(folder / f"{name}_recorded.csv", arm, bounds)


design("first")
design("judge", seed=7)
first, judge = record("first"), record("judge")""",
    ),
    (
        "markdown",
        """## Identify, and predict a motion that was not used

Every link comes out as a body that could be built. The noise floor is what differs between repeated periods, by the same filter: no
model can be below it but by chance.""",
    ),
    (
        "code",
        """def report(found):
    held_out = found.validations[0]
    print(f"{found.analysis.identifiable_count} of {theta.count} directions identified, band {found.spectra.hertz:g} Hz")
    print(f"{'torque error, held out [N m]':30}{'URDF':>9}{'identified':>12}{'noise floor':>13}")
    for row in zip(arm.joints, held_out.error("nominal"), held_out.error(), held_out.noise_floor, strict=True):
        print("{:30}{:9.3g}{:12.3g}{:13.3g}".format(*row))


before = identification.identify(arm, psi, theta, [first], [judge])
report(before)""",
    ),
    (
        "code",
        """held_out = before.validations[0]
figure = Figure(figsize=(9, 4.5), layout="constrained")
axes = figure.subplots(2, 2, sharex=True, height_ratios=(2, 1))
for column, joint in zip(axes.T, (1, 4), strict=True):
    column[0].plot(held_out.time, held_out.measured[:, joint], color="0.2", label="measured")
    column[0].plot(held_out.time, held_out.nominal[:, joint], color="0.7", label="by the URDF")
    column[0].plot(held_out.time, held_out.fitted[:, joint], color="tab:blue", linestyle="--", label="identified")
    column[0].set(title=arm.joints[joint], ylabel="torque [N m]")
    column[1].plot(held_out.time, held_out.measured[:, joint] - held_out.fitted[:, joint], color="tab:orange", linewidth=0.7)
    for sign in (-2.0, 2.0):
        column[1].axhline(sign * held_out.noise_floor[joint], color="0.4", linestyle=":")
    column[1].set(xlabel="time [s]", ylabel="residual [N m]")
figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False)
axes[1, 1].set_title("dotted: two noise floors", fontsize="small")
display(figure)""",
    ),
    (
        "markdown",
        """## What is still missing

Directions of the parameters, the worst first: what one would fit there by the data alone. In the model, the prior decides these.""",
    ),
    (
        "code",
        """weak = [d for d in before.analysis.directions if not d.identifiable]
for direction in weak[::-1][:6]:
    print("-", direction.words)""",
    ),
    (
        "markdown",
        """## Design again, for what is missing

`given` is the information of the first recording. The search then no longer pays for what is known. The noise that the
recording has shown replaces the assumed one, at the density of the trajectory's 100 rows a second.""",
    ),
    (
        "code",
        """root = before.data.information_root @ theta.matrix
noise = before.data.noise * np.sqrt(0.5 * 100.0 / before.spectra.hertz)
design("second", given=root.T @ root, noise=tuple(noise))
after = identification.identify(arm, psi, theta, [first, record("second")], [judge])
report(after)""",
    ),
    (
        "markdown",
        """Was it worth another motion, or would the first one once more have done? Repeating it halves every variance.""",
    ),
    (
        "code",
        """once, both = (1.0 / found.analysis.eigenvalues for found in (before, after))
figure = Figure(figsize=(8, 3.2), layout="constrained")
left, right = figure.subplots(1, 2, width_ratios=(2, 1))
left.semilogy(once, "o", color="0.6", label="first recording")
left.semilogy(0.5 * once, "--", color="0.6", label="the same motion once more")
left.semilogy(both, "o", color="tab:blue", markersize=4, label="first and second")
left.axhline(before.options.threshold, color="tab:red", linewidth=1)
left.set(xlabel="direction, the best seen first", ylabel="scale-free variance 1/λ")
left.legend(frameon=False)
errors = [found.validations[0].error() / found.validations[0].noise_floor for found in (before, after)]
for place, (error, colour) in enumerate(zip(errors, ("0.6", "tab:blue"), strict=True)):
    right.barh(np.arange(arm.n) + 0.4 * place, error, 0.4, color=colour)
right.axvline(1.0, color="tab:red", linewidth=1)
right.set(yticks=np.arange(arm.n) + 0.2, yticklabels=arm.joints, xlabel="held-out error over noise floor")
right.invert_yaxis()
display(figure)
worst = slice(-len(weak), None)
print(f"the {len(weak)} weak directions, median variance: {np.median(once[worst]):.3g} → {np.median(both[worst]):.3g}", end="")
print(f", by the same motion once more {np.median(0.5 * once[worst]):.3g}")
print("held-out error over the noise floor, RMS over joints: {:.3f} → {:.3f}".format(*(np.sqrt(np.mean(e**2)) for e in errors)))""",
    ),
    (
        "markdown",
        """The command line does the same, with a report that draws all of this and more:

```
scripts/excite identify ur10e first.csv --validate judge.csv -o out/model
scripts/excite design ur10e --given first.csv --validation -o out/second
scripts/excite identify ur10e first.csv second.csv --validate judge.csv -o out/better
```""",
    ),
]

REAL_MACHINES = [
    (
        "markdown",
        """# What the models of four real machines leave out

Recordings that others have published, whose truth they document and the tool is not told. Their folder is named by
`EXCITE_RECORDINGS`, else it is `../../shared/recordings`. Every diagnosis here is what
`excite diagnose ROBOT TRAIN… --validate HELD_OUT [--prior FILE]` does, without its report.""",
    ),
    (
        "code",
        """%matplotlib inline
import os
import warnings
from pathlib import Path

import numpy as np
from IPython.display import display
from matplotlib.figure import Figure

from excite import base, limits, parameters, recordings, robot
from excite.diagnose import diagnosis
from excite.diagnose.document import document
from excite.identify import priors

warnings.simplefilter("ignore")
REAL = Path(os.environ.get("EXCITE_RECORDINGS", "../../shared/recordings"))


def diagnosed(folder, urdf, train, held_out, prior=None, band=None):
    place = REAL / folder
    machine = robot.load(str(place / urdf))
    table = limits.resolve(machine)
    standard = parameters.standard(machine, table)
    first, last = ([recordings.read(place / f"{name}.csv", machine, table) for name in names] for names in (train, held_out))
    known = priors.trusted(place / prior, machine, standard) if prior else {}
    options = diagnosis.Options(band, known)
    return diagnosis.diagnose(machine, standard, base.find(machine, standard, table), first, last, options)


def told(found):
    joints = found.identified.model.robot.joints
    print(f"{found.name}; band {found.hertz:.0f} Hz, noise by {found.method}")
    for one in document(found)["findings"]:
        words = ", ".join(f"{key} {v['value']:.4g} ± {v['std']:.2g} {v['unit']}" for key, v in one["parameters"].items())
        print(f"  {one['effect']} at {one['joint'] or 'all'} (p {one['probability']:.2f}): {words}")
    for one in document(found)["between_recordings"]:
        words = ", ".join(f"{key} {one[key]['value']:+.3g} ± {one[key]['std']:.2g}" for key in ("coulomb", "viscous", "offset"))
        print(f"  another drive at {one['joint']} in {Path(one['recording']).name}: {words}")
    for joint, before, after, whole in zip(joints, found.before, found.after, found.torque, strict=True):
        print(f"  {joint:10} held-out error {100 * before / whole:6.1f} % → {100 * after / whole:5.1f} %")


def drawn(found, joint, seconds=None):
    track = found.tracks[1][0]
    shown = slice(0, len(track)) if seconds is None else track.time < track.time[0] + seconds
    figure = Figure(figsize=(8, 3.0), layout="constrained")
    axes = figure.subplots()
    for residual, colour, label in zip(found.residuals, ("0.6", "tab:blue"), ("base model", "with the findings"), strict=True):
        left = np.where(track.moves, residual[: len(track)], np.nan)[shown, joint]
        axes.plot(track.time[shown], left, color=colour, linewidth=0.9, label=label)
    axes.axhspan(-found.floor[joint], found.floor[joint], color="tab:red", alpha=0.15, label="± noise floor")
    name = found.identified.model.robot.joints[joint]
    axes.set(xlabel="time [s]", ylabel="torque left, held out", title=name)
    axes.legend(frameon=False, ncols=3)
    display(figure)""",
    ),
    (
        "markdown",
        """## EMPS: one prismatic servo axis

Known: viscous friction of 167 N s/m one way and 240 the other. The motion repeats, so the noise floor is known, though
no sidecar says so. The pulses were met by a little more friction than the motion that the model is fitted to: what is left of
them is that, and the tool says so.""",
    ),
    (
        "code",
        """emps = diagnosed("emps", "emps.urdf", ["train"], ["validate_pulses"])
told(emps)
drawn(emps, 0)""",
    ),
    (
        "markdown",
        """## TX40: a wrist whose last motor turns with two joints

Known: the motor of axis 6 turns with q₅ + q₆; its friction, 0.62 viscous and 1.95 Coulomb, loads axis 5.""",
    ),
    (
        "code",
        """tx40 = diagnosed("tx40", "tx40.urdf", ["train"], ["validate"])
told(tx40)
drawn(tx40, 4)""",
    ),
    (
        "markdown",
        """## KUKA KR300: a load, a gas spring and a prior

The CAD's inertias and the rotors are trusted; friction and offsets are not known. Known: about 150 kg at the flange, a
counterbalance on axis 2, elastic joints with lost motion. The wrist is badly explained by the published model too.""",
    ),
    (
        "code",
        """kuka = diagnosed("kuka_kr300", "kuka_kr300.urdf", ["traj_A", "traj_B"], ["traj_C"], prior="prior.json")
told(kuka)
drawn(kuka, 1)""",
    ),
    (
        "markdown",
        """Where an axis stands still nothing is judged: static friction is whatever holds it.

Axes 1 to 3 have a second encoder, behind the gear. What it reads differently is mostly its clock, 2.8 ms; the rest winds up with
the torque that the gear carries. Known: 4.6, 7.5 and 4.1 MN m/rad, and lost motion.""",
    ),
    (
        "code",
        """figure = Figure(figsize=(9, 2.8), layout="constrained")
for axes, gear in zip(figure.subplots(1, len(kuka.gears)), kuka.gears, strict=True):
    load = np.linspace(gear.load.min(), gear.load.max(), 101)
    axes.plot(gear.load, 1e3 * gear.windup, ".", color="0.6", markersize=2)
    axes.plot(load, 1e3 * gear.curve(load), color="tab:orange")
    stiffness = "" if gear.stiffness is None else f"{1e-6 * gear.stiffness[0]:.1f} ± {1e-6 * gear.stiffness[1]:.1f} MN m/rad"
    axes.set(title=f"axis {gear.joint + 1}: {stiffness}", xlabel="torque carried [N m]", ylabel="wind-up [mrad]")
    print(f"axis {gear.joint + 1}: read {1e3 * gear.apart[0]:.2f} ms apart; {1e3 * gear.before:.2f} → {1e3 * gear.after:.3f} mrad held out")
    print("  lost motion", "not seen" if gear.play is None else f"{1e3 * gear.play[0]:.3f} ± {1e3 * gear.play[1]:.3f} mrad")
display(figure)""",
    ),
    (
        "markdown",
        """## A bare motor: cogging

Known: 72 cycles a turn and multiples. The band follows from the torque's lines.""",
    ),
    (
        "code",
        """motor = diagnosed("laas_cogging", "motor.urdf", ["speed_1rev_per_s_comp_off_then_on"], ["speed_test_b"])
told(motor)
orders = [motor.design.shapes[part.shape].values.get("order") for finding in motor.verdict.findings for part in finding.parts]
print("orders a turn:", [round(order, 2) for order in orders if order])
drawn(motor, 0, seconds=2.0)""",
    ),
]

NOTEBOOKS = {
    "first_trajectory": FIRST_TRAJECTORY,
    "identify_and_design_again": IDENTIFY_AND_DESIGN_AGAIN,
    "real_machines": REAL_MACHINES,
}


def written(name: str, cells: list[tuple[str, str]]) -> None:
    notebook = nbformat.v4.new_notebook()
    for number, (kind, text) in enumerate(cells):
        cell = (
            nbformat.v4.new_markdown_cell(text)
            if kind == "markdown"
            else nbformat.v4.new_code_cell(text)
        )
        cell["id"] = f"cell-{number}"
        notebook.cells.append(cell)
    nbformat.write(notebook, Path(__file__).resolve().parent.parent / "notebooks" / f"{name}.ipynb")


def main() -> None:
    for name, cells in NOTEBOOKS.items():
        written(name, cells)


if __name__ == "__main__":
    main()

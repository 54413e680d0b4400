"""Write the notebooks from the cells below, as text, so that changes can be read in a diff."""

from __future__ import annotations

from pathlib import Path

import nbformat

FIRST_TRAJECTORY = [
    (
        "markdown",
        """# A first excitation trajectory

This notebook designs a motion that identifies the inertial parameters of a robot, step
by step, in Python. Run it from the folder `notebooks/`, after `scripts/excite robots`
has installed the package.""",
    ),
    (
        "code",
        """%matplotlib inline
import numpy as np
from IPython.display import display
from matplotlib.figure import Figure

from excite.designer import criteria, pipeline
from excite.designer.criteria import Criterion
from excite.designer.options import DesignOptions
from excite.robot import base_parameters, dynamics, inertial_parameters, limits, robot""",
    ),
    (
        "markdown",
        """## Base parameters

Not every inertial parameter influences the joint torques. Identifiable are only certain
linear combinations, the *base parameters* θ = Bψ. The list below names each and shows
its combination.""",
    ),
    (
        "code",
        """arm = robot.load("two_link")
bounds = limits.resolve(arm)
psi = inertial_parameters.standard_parameters(arm, bounds)
theta = base_parameters.find(arm, psi, bounds)
print(f"{psi.count} standard parameters, {theta.count} base parameters")
for name, expression in zip(np.array(psi.names)[theta.independent], theta.expressions, strict=True):
    print(f"  {name:6} = {expression}")""",
    ),
    (
        "markdown",
        """## Two designs

`pipeline.design_trajectory` optimises a Fourier series, adds ramps from and to rest,
and certifies the complete motion against all limits. One design is A-optimal (least
mean variance) in the metric of physically consistent parameters, the other D-optimal
(least volume of the confidence ellipsoid).

Each line lists the criteria of a design and the limit that it comes closest to.""",
    ),
    (
        "code",
        """designs = {
    criterion: pipeline.design_trajectory(arm, bounds, DesignOptions(criterion=criterion, starts=1))
    for criterion in (Criterion.A, Criterion.D)
}
for criterion, design in designs.items():
    scores = design.trajectory.criteria["optimum"]["geometric"]
    worst = design.certificate.worst()
    print(
        criterion.name,
        {k: float(f"{v:.4g}") for k, v in scores.items()},
        "certified:",
        design.certificate.ok,
        f"| nearest limit: {worst.limit} of {worst.joint}, {100 * worst.free_share:.2f} % free",
    )""",
    ),
    (
        "markdown",
        """The figure shows positions (top) and torques (bottom) of both designs. Look at how both
use the whole range of positions, and at the torque peaks: the D-optimal motion excites
all directions, the A-optimal one spends its effort on the directions that are hardest
to see.""",
    ),
    (
        "code",
        """figure = Figure(figsize=(9, 4), layout="constrained")
axes = figure.subplots(2, 2, sharex=True)
for column, (criterion, design) in enumerate(designs.items()):
    motion = design.trajectory.motion
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
        """## Predicted variances

The eigenvalues λ of I·H₀⁻¹ do not depend on units and frames: 1/λ is the variance of a
direction of the parameters relative to the nominal robot. Below 0.01 (a standard
deviation of about 10 %, dashed line) a direction counts as practically identifiable.
Look at how many points lie below the line for each design.""",
    ),
    (
        "code",
        """figure = Figure(figsize=(7, 3.2), layout="constrained")
axis = figure.subplots()
for criterion, design in designs.items():
    motion = design.trajectory.motion
    noise = design.trajectory.noise
    weighting = criteria.criterion_weighting(Criterion.A, theta, noise, plain=False)
    samples = motion.samples(motion.grid(100.0))
    rows = weighting.rows(dynamics.regressor(arm, psi, samples))
    eigenvalues = len(samples) * criteria.information_eigenvalues(rows)
    axis.semilogy(np.sort(1.0 / eigenvalues), "o-", label=f"designed for {criterion.name}")
axis.axhline(1e-2, color="0.4", linestyle="--", linewidth=1)
axis.set(xlabel="direction", ylabel="scale-free variance 1/λ")
axis.legend(frameon=False)
display(figure)""",
    ),
    (
        "markdown",
        """The command line does the same and writes the files that a controller reads:

```
scripts/excite design two_link -o out/two_link
scripts/excite export out/two_link/trajectory.json --format ros2-joint-trajectory -o two_link.yaml
```""",
    ),
]

IDENTIFY_AND_DESIGN_AGAIN = [
    (
        "markdown",
        """# From recordings to parameters, and the next motion

This notebook designs a motion, records a robot that follows it, identifies the robot,
and designs the next motion for the parameters that are still uncertain.

The robot is simulated by `excite.simulator` (`.venv/bin/pip install -e '.[sim]'`), which shares
no code with the estimator. Its bodies differ from the URDF by about 5 %; its friction,
rotor inertia and offsets are in no file. Use your own recordings where you have a
robot.""",
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

from excite import _json, recordings
from excite.designer import pipeline
from excite.designer.options import DesignOptions
from excite.identification import identification
from excite.robot import base_parameters, inertial_parameters, limits, robot
from excite.simulator import experiment

arm = robot.load("ur10e")
bounds = limits.resolve(arm)
psi = inertial_parameters.standard_parameters(arm, bounds)
theta = base_parameters.find(arm, psi, bounds)
folder = Path(tempfile.mkdtemp())""",
    ),
    (
        "markdown",
        """## Design and record

Two motions are designed: one to fit the model, one with another seed to validate it.
The searches are short, so that the notebook runs in seconds. Each motion has three
periods: the first half second, in which the control loop settles, is left out, and a
noise floor needs two complete periods. A recording is a CSV with `t`, `q.<joint>` and
`tau.<joint>`; the sidecar `.json` states the period.""",
    ),
    (
        "code",
        """def design(name, information=None, **options):
    options = DesignOptions(period=5.0, periods=3, starts=1, iterations=40, **options)
    result = pipeline.design_trajectory(arm, bounds, options, earlier_information=information)
    (folder / f"{name}.json").write_text(_json.dumps(result.trajectory.document()))
    print(f"{name}: {result.trajectory.motion.duration:.1f} s, certified: {result.certificate.ok}")


def record(name):
    settings = experiment.ExperimentSettings(seed=3, rate=250.0)
    session = experiment.simulate(robot.locate("ur10e"), folder / f"{name}.json", settings)
    (folder / f"{name}_recorded.csv").write_text(session.recording.to_csv())
    (folder / f"{name}_recorded.json").write_text(json.dumps(session.recording.to_sidecar()))
    return recordings.read(folder / f"{name}_recorded.csv", arm, bounds)


design("first")
design("validation", seed=7)
first, validation = record("first"), record("validation")""",
    ),
    (
        "markdown",
        """## Identify and validate

All identified links are physically consistent. The table compares the torque error on
the held-out motion with the noise floor, which is the difference between repeated
periods after the same filter: a model can be below it by chance only. The identified
model should be close to it, the URDF far above.""",
    ),
    (
        "code",
        """def report(result):
    held_out = result.validations[0]
    count = result.analysis.identifiable_count
    print(f"{count} of {theta.count} directions identified, band {result.spectra.hertz:g} Hz")
    print(f"{'torque error, held out [N m]':30}{'URDF':>9}{'identified':>12}{'noise floor':>13}")
    errors = held_out.error("nominal"), held_out.error(), held_out.noise_floor
    for row in zip(arm.joints, *errors, strict=True):
        print("{:30}{:9.3g}{:12.3g}{:13.3g}".format(*row))


before = identification.identify(arm, psi, theta, [first], [validation])
report(before)""",
    ),
    (
        "markdown",
        """The figure shows two joints of the held-out motion. The identified model (dashed) should
cover the measured torque; the residual below should look like noise and stay within two
noise floors (dotted).""",
    ),
    (
        "code",
        """held_out = before.validations[0]
figure = Figure(figsize=(9, 4.5), layout="constrained")
axes = figure.subplots(2, 2, sharex=True, height_ratios=(2, 1))
for column, joint in zip(axes.T, (1, 4), strict=True):
    measured, fitted = held_out.measured[:, joint], held_out.fitted[:, joint]
    column[0].plot(held_out.time, measured, color="0.2", label="measured")
    column[0].plot(held_out.time, held_out.nominal[:, joint], color="0.7", label="URDF")
    column[0].plot(held_out.time, fitted, color="tab:blue", linestyle="--", label="identified")
    column[0].set(title=arm.joints[joint], ylabel="torque [N m]")
    column[1].plot(held_out.time, measured - fitted, color="tab:orange", linewidth=0.7)
    for sign in (-2.0, 2.0):
        column[1].axhline(sign * held_out.noise_floor[joint], color="0.4", linestyle=":")
    column[1].set(xlabel="time [s]", ylabel="residual [N m]")
handles = axes[0, 0].get_legend_handles_labels()
figure.legend(*handles, loc="outside upper right", ncols=3, frameon=False)
axes[1, 1].set_title("dotted: two noise floors", fontsize="small")
display(figure)""",
    ),
    (
        "markdown",
        """## Directions that are not identified

The list names the directions of the parameters that the recording does not determine,
the worst first. In the model, the prior decides them.""",
    ),
    (
        "code",
        """weak = [d for d in before.analysis.directions if not d.identifiable]
for direction in weak[::-1][:6]:
    print("-", direction.words)""",
    ),
    (
        "markdown",
        """## Design the next motion

`earlier_information` is the information of the first recording: the second design gains
nothing from directions that are known already. The measured noise replaces the assumed
one, converted to the density of the trajectory's 100 rows per second.""",
    ),
    (
        "code",
        """root = before.data.information_root @ theta.matrix
noise = before.data.noise * np.sqrt(0.5 * 100.0 / before.spectra.hertz)
design("second", information=root.T @ root, noise=tuple(noise))
after = identification.identify(arm, psi, theta, [first, record("second")], [validation])
report(after)""",
    ),
    (
        "markdown",
        """Was a second motion worth it, or would a repeat of the first have been enough? A repeat
halves every variance (dashed line). Look at the weak directions on the right side of
the left panel: with the second motion (blue) they should lie well below the dashed
line. The right panel compares the held-out errors with the noise floor.""",
    ),
    (
        "code",
        """results = (before, after)
one_motion, two_motions = (1.0 / result.analysis.eigenvalues for result in results)
figure = Figure(figsize=(8, 3.2), layout="constrained")
left, right = figure.subplots(1, 2, width_ratios=(2, 1))
left.semilogy(one_motion, "o", color="0.6", label="first recording")
left.semilogy(0.5 * one_motion, "--", color="0.6", label="first motion repeated")
left.semilogy(two_motions, "o", color="tab:blue", markersize=4, label="first and second")
left.axhline(before.options.threshold, color="tab:red", linewidth=1)
left.set(xlabel="direction, best determined first", ylabel="scale-free variance 1/λ")
left.legend(frameon=False)
held_out = [result.validations[0] for result in (before, after)]
errors = [prediction.error() / prediction.noise_floor for prediction in held_out]
for row, (error, colour) in enumerate(zip(errors, ("0.6", "tab:blue"), strict=True)):
    right.barh(np.arange(arm.n) + 0.4 * row, error, 0.4, color=colour)
right.axvline(1.0, color="tab:red", linewidth=1)
right.set(yticks=np.arange(arm.n) + 0.2, yticklabels=arm.joints)
right.set(xlabel="held-out error over noise floor")
right.invert_yaxis()
display(figure)
worst = slice(-len(weak), None)
medians = [np.median(values[worst]) for values in (one_motion, two_motions, 0.5 * one_motion)]
print("the {} weak directions, median variance: {:.3g} → {:.3g}".format(len(weak), *medians[:2]))
print(f"the same with the first motion repeated: {medians[2]:.3g}")
rms = [np.sqrt(np.mean(error**2)) for error in errors]
print("held-out error over the noise floor, RMS over joints: {:.3f} → {:.3f}".format(*rms))""",
    ),
    (
        "markdown",
        """The command line does the same, with a report:

```
scripts/excite identify ur10e first.csv --validate validation.csv -o out/model
scripts/excite design ur10e --given first.csv --validation -o out/second
scripts/excite identify ur10e first.csv second.csv --validate validation.csv -o out/better
```""",
    ),
]

REAL_MACHINES = [
    (
        "markdown",
        """# Unmodelled effects of four real machines

These recordings were published by others, with known effects that the tool is not
given. Their folder is `../../shared/recordings`, or the one that `EXCITE_RECORDINGS`
states. Each diagnosis is that of `excite diagnose ROBOT TRAIN… --validate HELD_OUT
[--prior FILE]`, without the report.

Below each diagnosis, compare the findings with the published facts, and the errors
before (base model) and after (with all effects of the model), of which each effect
explains a share. The figures show the held-out residual of both models; the band is the
noise floor.""",
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

import excite

warnings.simplefilter("ignore")
REAL = Path(os.environ.get("EXCITE_RECORDINGS", "../../shared/recordings"))


def diagnose(folder, urdf, train, held_out, prior=None):
    training, validation = (
        [REAL / folder / f"{name}.csv" for name in names] for names in (train, held_out)
    )
    return excite.diagnose(
        REAL / folder / urdf,
        training,
        validation,
        prior=None if prior is None else REAL / folder / prior,
        with_report=False,
    )


def print_findings(result):
    document = result.document()
    print(f"{document['verdict']}; band {document['band_hz']:.0f} Hz")
    for finding in document["findings"]:
        values = ", ".join(
            f"{key} {v['value']:.4g} ± {v['std']:.2g} {v['unit']}"
            for key, v in finding["parameters"].items()
        )
        place = finding["joint"] or "all joints"
        print(f"  {finding['effect']} at {place} (p {finding['probability']:.2f}): {values}")
    for change in document["between_recordings"]:
        values = ", ".join(
            f"{key} {change[key]['value']:+.3g} ± {change[key]['std']:.2g}"
            for key in ("coulomb", "viscous", "offset")
        )
        name = Path(change["recording"]).name
        print(f"  changed actuator at {change['joint']} in {name}: {values}")
    for joint, shares in document["budget"].items():
        explained = ", ".join(
            f"{effect} {100 * entry['share']:.0f} %" for effect, entry in shares.items()
        )
        errors = document["joints"][joint]
        print(
            f"  {joint:10} held-out error {errors['rmse_before']:.3g}"
            f" → {errors['rmse_after']:.3g}; share of it: {explained}"
        )


def draw_residual(result, joint, seconds=None):
    held_out = result.diagnosis.held_out
    motion = held_out.motions[0]
    shown = slice(0, len(motion)) if seconds is None else motion.time < motion.time[0] + seconds
    figure = Figure(figsize=(8, 3.0), layout="constrained")
    axes = figure.subplots()
    curves = zip(
        (held_out.base, held_out.final),
        ("0.6", "tab:blue"),
        ("base model", "with the effects"),
        strict=True,
    )
    for residual, colour, label in curves:
        moving = np.where(motion.moving, residual[: len(motion)], np.nan)[shown, joint]
        axes.plot(motion.time[shown], moving, color=colour, linewidth=0.9, label=label)
    floor = result.diagnosis.noise.floor[joint]
    axes.axhspan(-floor, floor, color="tab:red", alpha=0.15, label="± noise floor")
    name = result.diagnosis.identified.model.robot.joints[joint]
    axes.set(xlabel="time [s]", ylabel="residual, held out", title=name)
    axes.legend(frameon=False, ncols=3)
    display(figure)""",
    ),
    (
        "markdown",
        """## EMPS: one prismatic servo axis

Published: viscous friction of 167 N s/m in one direction and 240 N s/m in the other.
The tool detects that the motion repeats, so that the noise floor is known. The held-out
pulses show slightly more friction than the training motion; the diagnosis reports this
as a change of the actuator between the recordings.""",
    ),
    (
        "code",
        """emps = diagnose("emps", "emps.urdf", ["train"], ["validate_pulses"])
print_findings(emps)
draw_residual(emps, 0)""",
    ),
    (
        "markdown",
        """## TX40: a coupled wrist

Published: the motor of axis 6 turns with q₅ + q₆; its friction (viscous 0.62, Coulomb
1.95) loads axis 5. Look for the effect `coupling` at joint 5, and at the residual that
it removes.""",
    ),
    (
        "code",
        """tx40 = diagnose("tx40", "tx40.urdf", ["train"], ["validate"])
print_findings(tx40)
draw_residual(tx40, 4)""",
    ),
    (
        "markdown",
        """## KUKA KR300: a load, a gas spring and a prior

The prior trusts the inertias of the CAD model and the rotor inertias; friction and
offsets are not known. Published: about 150 kg at the flange, a counterbalance (gas
spring) on axis 2, elastic joints with backlash. The published model explains the wrist
poorly as well. Gaps in the figure are times at which the axis stands still: static
friction takes any value there, so nothing is judged.""",
    ),
    (
        "code",
        """training, validation = ["traj_A", "traj_B"], ["traj_C"]
kuka = diagnose("kuka_kr300", "kuka_kr300.urdf", training, validation, prior="prior.json")
print_findings(kuka)
draw_residual(kuka, 1)""",
    ),
    (
        "markdown",
        """Axes 1 to 3 have a second encoder behind the gear. Most of the difference between both
encoders is a delay of 2.8 ms; the remainder grows with the torque that the gear
transmits. The figure shows this deflection (grey) and the fitted curve, whose slope is
the compliance. Published: 4.6, 7.5 and 4.1 MN m/rad, and backlash.""",
    ),
    (
        "code",
        """figure = Figure(figsize=(9, 2.8), layout="constrained")
gears = kuka.diagnosis.gears
for axes, gear in zip(figure.subplots(1, len(gears)), gears, strict=True):
    load = np.linspace(gear.load.min(), gear.load.max(), 101)
    axes.plot(gear.load, 1e3 * gear.deflection, ".", color="0.6", markersize=2)
    axes.plot(load, 1e3 * gear.curve(load), color="tab:orange")
    stiffness = ""
    if gear.stiffness is not None:
        stiffness = "{:.1f} ± {:.1f} MN m/rad".format(*(1e-6 * value for value in gear.stiffness))
    axes.set(title=f"axis {gear.joint + 1}: {stiffness}")
    axes.set(xlabel="transmitted torque [N m]", ylabel="deflection [mrad]")
    print(
        f"axis {gear.joint + 1}: delay between encoders {1e3 * gear.read_delay[0]:.2f} ms; "
        f"RMS difference {1e3 * gear.before:.2f} → {1e3 * gear.after:.3f} mrad held out"
    )
    backlash = "not significant"
    if gear.backlash is not None:
        backlash = "{:.3f} ± {:.3f} mrad".format(*(1e3 * value for value in gear.backlash))
    print("  backlash", backlash)
display(figure)""",
    ),
    (
        "markdown",
        """## A bare motor: cogging

Published: torque ripple of 72 cycles per turn and its multiples. The tool chooses the
band by the lines in the torque's spectrum. Look at the orders that are printed, and at
how much of the residual they explain.""",
    ),
    (
        "code",
        """training, validation = ["speed_1rev_per_s_comp_off_then_on"], ["speed_test_b"]
motor = diagnose("laas_cogging", "motor.urdf", training, validation)
print_findings(motor)
effects = motor.model()["effects"]
orders = [e["values"]["order"] for e in effects if e["effect"] == "torque_ripple"]
print("orders [1/turn]:", [round(order, 2) for order in sorted(orders)])
draw_residual(motor, 0, seconds=2.0)""",
    ),
]

DESIGN_FOR_A_TASK = [
    (
        "markdown",
        """# Design, record, identify, and design again, until the task is known

A robot repeats a task, and its torque along this task is what the model is for. This
notebook designs the motion that predicts the task best, records a robot that follows
it, identifies the robot, and repeats this with all recordings so far as `given`. It
stops by the rule that the tool prints: the task's torque is known to 1 %, and one
more run would gain less than 0.1 %.

The robot is simulated (`.venv/bin/pip install -e '.[sim]'`).""",
    ),
    (
        "code",
        """%matplotlib inline
import tempfile
from pathlib import Path

import numpy as np
from IPython.display import display
from matplotlib.figure import Figure

import excite
from excite.robot.limits import resolve

arm = excite.load_robot("ur10e")
folder = Path(tempfile.mkdtemp())
NOISE = 0.03  # torque noise over the torque limits, as of motor currents""",
    ),
    (
        "markdown",
        """## The task

A task is a recording; only its positions are used. Here the arm swings between two
places, and its wrist hardly moves. A motion for all parameters would spend most of its
time on what this task never shows.""",
    ),
    (
        "code",
        """t = np.arange(0.0, 6.0, 0.01)
pick = np.array([-0.6, -1.2, 1.5, -1.8, -1.5, 0.0])
place = np.array([0.8, -0.8, 1.0, -1.7, -1.5, 0.3])
share = 0.5 - 0.5 * np.cos(2.0 * np.pi * t / 3.0)
q = pick + share[:, None] * (place - pick)
task = folder / "task.csv"
header = ",".join(["t", *(f"q.{joint}" for joint in arm.joints)])
np.savetxt(task, np.column_stack([t, q]), delimiter=",", header=header, comments="")""",
    ),
    (
        "markdown",
        """## The loop

Each round designs for the task with what is given, records the motion, and identifies
from all recordings. `design.task` predicts the torque band along the task before the
motion, after it, and after one more run of the same motion.

Look at how fast the standard deviation falls, and at the gain of one more run, which
ends the loop; `prediction.advice` is the last line of each round.""",
    ),
    (
        "code",
        """given, first = [], None
for number in range(4):
    design = excite.design(
        arm,
        for_task=task,
        given=given,
        noise=tuple(NOISE * resolve(arm).torque),
        starts=2,
        iterations=60,
        period=4.0,
    )
    prediction = design.task
    first = prediction.after if number == 0 else first
    print(f"run {number + 1}, certified: {design.ok}; {prediction.summary()}")
    design.save(folder / f"run{number}")
    recording = excite.simulate(
        "ur10e", folder / f"run{number}" / "trajectory.json", seed=3, rate=125.0
    )
    given += [path for path in recording.save(folder / f"run{number}.csv") if path.suffix == ".csv"]
    model = excite.identify(arm, given)
    if prediction.is_last:
        break""",
    ),
    (
        "markdown",
        """## The band along the task

The shaded band is ± two predicted standard deviations around the nominal torque of the
URDF: after the first run (grey) and after the last (blue). Look at where the band stays
widest.""",
    ),
    (
        "code",
        """figure = Figure(figsize=(9, 3.2), layout="constrained")
for axis, joint in zip(figure.subplots(1, 2), (1, 2), strict=True):
    torque = prediction.torque[:, joint]
    for band, colour in ((first, "0.85"), (prediction.after, "tab:blue")):
        std = band.std[:, joint]
        axis.fill_between(t, torque - 2 * std, torque + 2 * std, color=colour, alpha=0.7)
    axis.plot(t, torque, color="0.2", linewidth=0.8)
    axis.set(title=arm.joints[joint], xlabel="time [s]", ylabel="torque [N m]")
display(figure)""",
    ),
    (
        "markdown",
        """The command line does the same:

```
scripts/excite design ur10e --for task.csv -o out/run1
scripts/excite design ur10e --for task.csv --given run1.csv -o out/run2
scripts/excite design ur10e --for task.csv --given run1.csv --given run2.csv -o out/run3
```

Each prints how well the torque along the task is known, and what one more run would
gain.""",
    ),
]

FLOATING_BASE = [
    (
        "markdown",
        """# A robot on its feet: design, simulate, identify

No joint torque is needed to identify the bodies of a legged robot: the wrench of the
ground and the motion of all links suffice. This notebook designs motions of a biped that
stands on both feet, simulates them in MuJoCo (`.venv/bin/pip install -e '.[sim]'`), and
identifies the robot from the simulated contact wrenches. The last figure shows which
bodies the recording decides, and which ones the prior.""",
    ),
    (
        "code",
        """%matplotlib inline
import tempfile
from pathlib import Path

import numpy as np
from IPython.display import display
from matplotlib.figure import Figure

import excite
from excite.designer.support_design import SupportOptions
from excite.designer.support_stance import SoleSize

folder = Path(tempfile.mkdtemp())""",
    ),
    (
        "markdown",
        """## The robot

A biped of 44 kg: two legs of six joints, a torso that turns, and an arm. Every URDF with
such legs will do; its meshes are not needed.""",
    ),
    (
        "code",
        """LEG = (  # joint, axis, range [rad], place in the parent [m], mass of its link [kg]
    ("hip_yaw", "0 0 1", (-0.6, 0.6), "0 0 -0.05", 1.0),
    ("hip_roll", "1 0 0", (-0.5, 0.5), "0 0 0", 1.2),
    ("hip_pitch", "0 1 0", (-2.0, 0.7), "0 0 0", 4.0),
    ("knee", "0 1 0", (0.0, 2.4), "0 0 -0.38", 3.0),
    ("ankle_pitch", "0 1 0", (-1.3, 0.8), "0 0 -0.33", 0.8),
    ("ankle_roll", "1 0 0", (-0.5, 0.5), "0 0 0", 1.1),
)


def link(name, mass, height=-0.1):
    return (
        f'<link name="{name}"><inertial><origin xyz="0.01 0 {height}"/><mass value="{mass}"/>'
        f'<inertia ixx="{0.01 * mass}" iyy="{0.012 * mass}" izz="{0.006 * mass}" ixy="0" '
        'ixz="0" iyz="0"/></inertial></link>'
    )


def joint(name, parent, child, place, axis, span):
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{place}"/><axis xyz="{axis}"/>'
        f'<limit lower="{span[0]}" upper="{span[1]}" velocity="5" effort="150"/></joint>'
    )


parts = [link("pelvis", 9.0, 0.05), link("torso", 10.0, 0.2), link("arm", 3.0, -0.25)]
parts.append(joint("waist", "pelvis", "torso", "0 0 0.15", "0 0 1", (-1.0, 1.0)))
parts.append(joint("shoulder", "torso", "arm", "0 0.2 0.4", "0 1 0", (-1.5, 1.5)))
for side, sign in (("left", 1.0), ("right", -1.0)):
    parent = "pelvis"
    for name, axis, span, place, mass in LEG:
        child = f"{side}_{name}_link"
        origin = f"0 {0.09 * sign} -0.08" if parent == "pelvis" else place
        parts += [joint(f"{side}_{name}", parent, child, origin, axis, span), link(child, mass)]
        parent = child
    parts.append(
        f'<link name="{side}_sole"/><joint name="{side}_sole_joint" type="fixed">'
        f'<parent link="{parent}"/><child link="{side}_sole"/><origin xyz="0 0 -0.09"/></joint>'
    )
urdf = folder / "biped.urdf"
urdf.write_text(f'<robot name="biped">{"".join(parts)}</robot>', encoding="utf-8")
biped = excite.load_floating_robot(urdf)
print(f"{biped.n} joints, {len(biped.bodies)} bodies, {biped.mass:.1f} kg")""",
    ),
    (
        "markdown",
        """## Motions in double support

Each motion starts and ends at rest in the same pose. The feet stay in place, the centre
of pressure stays inside the soles by 2 cm, and friction holds the feet. The certificate
checks all of this densely. Two motions serve to identify, a third one with another seed
to validate. The searches are short, so that the notebook runs in a minute.""",
    ),
    (
        "code",
        """FEET = ("left_sole", "right_sole")


def designed(name, **choices):
    sole = SoleSize(half_length=0.1, half_width=0.06, centre=(0.01, 0.0))
    options = SupportOptions(
        FEET, (sole, sole), duration=2.5, harmonics=3, starts=1, iterations=8, **choices
    )
    result = excite.design_support(biped, options)
    result.save(folder / name)
    design = result.design
    print(
        f"{name}: {design.identifiable_counts()[-1]} of {design.base.count} directions "
        f"identifiable, certified: {design.certificate.ok}"
    )


designed("motions", count=2)
designed("validation", seed=7)""",
    ),
    (
        "markdown",
        """## The simulated robot

Its true bodies deviate from the URDF by about 10 %. Position servos follow the plan; the
base is free, and only the contact forces of MuJoCo hold it. The recording contains the
pose of the base, the joint positions, the wrench of each foot and the joint torques.""",
    ),
    (
        "code",
        """def simulated(name):
    result = excite.simulate_standing(
        urdf, folder / name / "trajectory.json", model_error=0.1, wrench_noise=(0.5, 0.1), seed=4
    )
    standing = result.truth["standing"]
    print(
        f"{name}: follows the plan within {1e3 * max(standing['tracking_error'].values()):.0f} "
        f"mrad, the soles slip by up to {1e3 * standing['slip']:.0f} mm"
    )
    return result, result.save(folder / f"{name}.csv")[0]


(recording, training), (_, held_out) = simulated("motions"), simulated("validation")""",
    ),
    (
        "markdown",
        """Look at how the weight moves from foot to foot (left), and at the centre of pressure of
the left foot. With bodies that the plan did not know it uses up the planned margin of
2 cm in places and reaches the edge of the sole (grey), but the robot does not tip over.""",
    ),
    (
        "code",
        """signal = dict(zip(recording.columns, recording.table.T, strict=True))
figure = Figure(figsize=(9, 3.0), layout="constrained")
left, right = figure.subplots(1, 2, width_ratios=(2, 1))
for foot in FEET:
    left.plot(signal["t"], signal[f"wrench.{foot}.fz"], label=foot)
left.set(xlabel="time [s]", ylabel="normal force [N]")
left.legend(frameon=False)
force = signal["wrench.left_sole.fz"]
x, y = -signal["wrench.left_sole.my"] / force, signal["wrench.left_sole.mx"] / force
right.fill([-0.09, 0.11, 0.11, -0.09], [-0.06, -0.06, 0.06, 0.06], color="0.9")
right.plot(x, y, linewidth=0.7)
right.set(xlabel="x [m]", ylabel="y [m]", title="centre of pressure", aspect="equal")
display(figure)""",
    ),
    (
        "markdown",
        """## Identify from the ground reaction

The six rows of the base alone are fitted: no joint torque, and no friction model. The
table compares the error of the wrench along the held-out motion, which the
identification has not seen, with the URDF's.""",
    ),
    (
        "code",
        """result = excite.identify_floating(urdf, [training], validate=[held_out], rows="base")
found = result.identification
prediction = found.validations[0]
print(f"{'held out':12}{'URDF':>10}{'identified':>12}")
errors = prediction.error("nominal"), prediction.error()
for row, before, after, unit in zip(
    found.model.joints, *errors, found.model.row_units(), strict=True
):
    print(f"{row:12}{before:10.2f}{after:12.2f} {unit}")
count = found.analysis.identifiable_count
print(f"{count} of {found.model.base.count} directions identified")""",
    ),
    (
        "markdown",
        """## Which bodies do the data decide?

The ground reaction determines only some combinations of masses and centres. Each bar
is the share of a body that the recording decides; the prior, physically consistent
bodies near the URDF's, decides the remainder. On the right, the masses: look at whether
the true ones (crosses) lie within two standard deviations of the identified ones, and
how wide the intervals are where the prior decides.""",
    ),
    (
        "code",
        """shares, links = found.body_shares(), found.links()
true = [recording.truth["parameters"][found.model.parameters.names[10 * i]] for i in range(15)]
nominal = found.prior.nominal[: 10 * len(links) : 10]
place = np.arange(len(links))
figure = Figure(figsize=(9, 4.2), layout="constrained")
left, right = figure.subplots(1, 2, sharey=True)
left.barh(place, [100.0 * shares[link.name] for link in links], color="tab:blue")
left.set(yticks=place, yticklabels=[link.name for link in links])
left.set(xlabel="decided by the data [%]")
left.invert_yaxis()
deviation = [2.0 * link.mass_deviation for link in links]
right.errorbar(
    [link.mass for link in links], place, xerr=deviation, fmt="o", markersize=4, label="identified"
)
right.plot(nominal, place, "|", color="0.5", markersize=10, label="URDF")
right.plot(true, place, "x", color="tab:red", label="true")
right.set(xlabel="mass [kg], ± two standard deviations")
right.legend(frameon=False)
display(figure)""",
    ),
    (
        "markdown",
        """The command line does the same, with reports:

```
scripts/excite design biped.urdf --floating --support left_sole,right_sole \\
    --sole 0.2,0.12,0.01,0 -o out/design
scripts/excite simulate biped.urdf out/design/trajectory.json --floating -o standing.csv
scripts/excite identify biped.urdf standing.csv --floating --rows base -o out/model
```

More: `excite/identification/FLOATING_BASE.md`.""",
    ),
]

NOTEBOOKS = {
    "design_for_a_task": DESIGN_FOR_A_TASK,
    "first_trajectory": FIRST_TRAJECTORY,
    "floating_base": FLOATING_BASE,
    "identify_and_design_again": IDENTIFY_AND_DESIGN_AGAIN,
    "real_machines": REAL_MACHINES,
}


def write_notebook(name: str, cells: list[tuple[str, str]]) -> None:
    """Write a notebook without outputs."""
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
    """Write all notebooks."""
    for name, cells in NOTEBOOKS.items():
        write_notebook(name, cells)


if __name__ == "__main__":
    main()

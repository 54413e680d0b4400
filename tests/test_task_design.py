"""Designs for a task: gradient of the predicted variance, torque band, command, refusals."""

from __future__ import annotations

import dataclasses
import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import loaded, random_urdf

from excite import api
from excite.api.design_result import CellOptions
from excite.api.task_design import read_task
from excite.cli.main import main
from excite.designer import identifiability, optimize, task_variance
from excite.designer.criteria import Criterion
from excite.designer.evaluator import Evaluator
from excite.designer.options import DesignOptions
from excite.designer.task_variance import TaskPrediction, TorqueBand
from excite.report.task import task_section
from excite.robot import dynamics
from excite.robot.limits import resolve
from excite.robot.robot import load

QUICK = ("--harmonics", "3", "--period", "2", "--samples", "60", "--starts", "2", "--jobs", "1")
OPTIONS = DesignOptions(period=2.0, harmonics=3, samples=60, starts=2, jobs=1)


def write_task(folder: Path) -> Path:
    """Write the positions of a slow task in which the first joint hardly moves."""
    t = np.arange(400) / 100.0
    q = np.column_stack([0.02 * np.sin(t), 0.5 + 0.6 * np.sin(1.5 * t)])
    path = folder / "task.csv"
    joints = ",".join(f"q.{joint}" for joint in load("two_link").joints)
    np.savetxt(
        path,
        np.column_stack([t, q]),
        delimiter=",",
        header=f"t,{joints}",
        comments="",
        fmt="%.9g",
    )
    return path


@cache
def robot():
    return load("two_link")


def designed(**options: object) -> api.DesignResult:
    return api.design(
        robot(),
        cell=CellOptions(check=False),
        period=2.0,
        harmonics=3,
        samples=60,
        starts=2,
        jobs=1,
        **options,
    )


@pytest.mark.parametrize("free_period", [None, (1.5, 3.0)])
def test_gradient_equals_finite_differences(
    tmp_path: Path, free_period: tuple[float, float] | None
):
    limits = resolve(robot())
    options = dataclasses.replace(OPTIONS, free_period=free_period)
    task = read_task(write_task(tmp_path), robot(), limits, options)
    prior = task_variance.prior_information(task.parameters)
    setup = optimize.set_up(robot(), limits, options, prior, objective=task.with_objective)
    evaluator, rng = Evaluator(setup.problem), np.random.default_rng(0)
    x = 0.3 * rng.normal(size=setup.problem.size)
    if free_period is not None:
        x[-1] = 1.1
    direction, step = rng.normal(size=x.shape), 1e-6
    _, gradient = evaluator.objective(x, 1.0)
    ends = [evaluator.objective(x + h * direction, 1.0)[0] for h in (step, -step)]
    assert gradient @ direction == pytest.approx((ends[0] - ends[1]) / (2.0 * step), rel=1e-6)


def test_the_objective_is_the_mean_variance_of_the_band(tmp_path: Path):
    """By the information of the periodic part alone."""
    limits = resolve(robot())
    task = read_task(write_task(tmp_path), robot(), limits, OPTIONS)
    prior = task_variance.prior_information(task.parameters)
    setup = optimize.set_up(robot(), limits, OPTIONS, prior, objective=task.with_objective)
    problem = setup.problem
    motion = problem.fourier(0.3 * np.random.default_rng(1).normal(size=problem.size))
    value, _ = Evaluator(problem).objective(problem.variables(motion), 1.0)
    samples = motion.samples(motion.grid(OPTIONS.samples))
    root = identifiability.information_root(robot(), task.parameters, samples, setup.noise)
    count = OPTIONS.periods * OPTIONS.period * OPTIONS.rate
    band = task_variance.torque_band(
        task.regressor, setup.base, root * np.sqrt(count / OPTIONS.samples)
    )
    assert np.exp(value) / count == pytest.approx(np.mean((band.std / setup.noise) ** 2), rel=1e-6)


def test_the_band_holds_the_errors_of_identified_robots(tmp_path: Path):
    result = designed(for_task=write_task(tmp_path))
    task, setup = result.task_design, result.delivery.design.setup
    assert task is not None and result.task is not None
    trajectory, W = result.trajectory, setup.base.geometric
    motion = trajectory.motion.samples(trajectory.motion.grid(100.0))
    Y = dynamics.regressor(robot(), task.parameters, motion) @ W
    rows = (Y / trajectory.noise[:, None]).reshape(-1, Y.shape[2])
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(2000, Y.shape[2]))
    noise = rng.normal(size=(2000, len(rows)))
    information = rows.T @ rows + np.eye(Y.shape[2])
    measured = truth @ rows.T + noise
    estimate = np.linalg.solve(information, rows.T @ measured.T).T
    error = np.einsum("tjp,dp->dtj", task.regressor[::20] @ W, estimate - truth)
    realised = np.sqrt(np.mean(error**2, axis=0))
    np.testing.assert_allclose(realised, result.task.after.std[::20], rtol=0.15)


def test_designing_for_the_task_beats_the_criteria_along_it(tmp_path: Path):
    path = write_task(tmp_path)
    best = designed(for_task=path)
    assert best.task is not None and best.task_design is not None
    variance = {}
    for name, result in {
        "task": best,
        "a": designed(criterion=Criterion.A),
        "d": designed(criterion=Criterion.D),
    }.items():
        designed_root = identifiability.information_root(
            robot(),
            best.task_design.parameters,
            result.trajectory.motion.fourier.samples(np.arange(200) / 100.0),
            result.trajectory.noise,
        )
        base = result.delivery.design.setup.base
        prediction = best.task_design.predict(robot(), base, None, designed_root)
        variance[name] = float(np.mean((prediction.after.std / prediction.noise) ** 2))
    assert variance["task"] <= min(variance["a"], variance["d"])


def test_the_command_reports_the_band_before_and_after(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path, out = write_task(tmp_path), tmp_path / "out"
    arguments = ["design", "two_link", "--for", str(path), "-o", str(out), "--json", *QUICK]
    assert main(arguments) == 0
    task = json.loads(capsys.readouterr().out)["task"]
    std = task["relative_std"]
    assert std["before"] > std["after"] > std["after_one_more"] > 0.0
    assert set(task["joints"]) == set(robot().joints)
    for entry in task["joints"].values():
        assert entry["before"]["rms"] > entry["after"]["rms"]
        assert entry["after"]["max"] >= entry["after"]["rms"]
    assert "How well will the torque of the task be known?" in (out / "report.html").read_text()
    # what is given narrows the band before
    given, second = str(out / "trajectory.json"), tmp_path / "second"
    arguments[arguments.index(str(out))] = str(second)
    assert main([*arguments, "--force", "--given", given, "--given", given]) == 0
    again = json.loads(capsys.readouterr().out)["task"]["relative_std"]
    assert again["before"] < 1.1 * std["after_one_more"]
    assert again["after"] < again["before"]
    assert main(["verify", str(second / "trajectory.json")]) == 0


@pytest.mark.slow
def test_the_text_states_what_was_optimised(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path, out = write_task(tmp_path), tmp_path / "out"
    assert main(["design", "two_link", "--for", str(path), "-o", str(out), *QUICK]) == 0
    text = capsys.readouterr().out
    assert "torque variance along the task over that of the noise: " in text
    assert "geometric" not in text


def test_the_section_states_forces_of_sliding_joints_in_newtons():
    machine = loaded(random_urdf(np.random.default_rng(4), 5, kinds=("revolute", "prismatic")))
    kinds = [entry.kind for entry in machine.entries]
    assert set(kinds) == {"revolute", "prismatic"}
    band = TorqueBand(np.ones((3, machine.n)))
    torque, noise = np.ones((3, machine.n)), np.ones(machine.n)
    task = TaskPrediction("task.csv", machine.joints, torque, noise, band, band, band)
    table = task_section(task, machine).data["table"]
    assert [row[-1] for row in table.rows] == ["N" if k == "prismatic" else "N m" for k in kinds]


@pytest.mark.parametrize(
    ("bands", "words"),
    [
        ((0.5, 0.05, 0.03), "design again with --given"),
        ((0.5, 0.005, 0.0035), "design again with --given"),
        ((0.5, 0.005, 0.0045), "record this motion, then stop"),
        ((0.005, 0.0045, 0.0042), "stop, what is given suffices"),
    ],
)
def test_the_stopping_rule_needs_a_known_task_and_a_small_gain(
    bands: tuple[float, ...], words: str
):
    unit = np.ones((1, 1))
    prediction = TaskPrediction(
        "task.csv", ("j",), unit, np.ones(1), *(TorqueBand(std * unit) for std in bands)
    )
    assert prediction.advice.startswith(words) or words in prediction.advice
    assert prediction.summary().splitlines()[1] == f"next: {prediction.advice}"
    assert prediction.document()["advice"] == prediction.advice


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--criterion", "d"), "leave out --criterion"),
        (("--plain",), "leave out --criterion and --plain"),
    ],
)
def test_another_criterion_is_one_line(
    more: tuple[str, ...], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = str(tmp_path / "out")
    task = str(write_task(tmp_path))
    assert main(["design", "two_link", "--for", task, "-o", out, *QUICK, *more]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "task.csv"),
        ("t,q.elbow\n0,1\n0.1,1\n0.2,1\n", "joint_1"),
        ("t,q.joint_1,q.joint_2\n" + "".join(f"{k / 100},0.1,0.2\n" for k in range(300)), "moves"),
    ],
)
def test_an_unusable_task_is_one_line(
    text: str | None, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = tmp_path / "task.csv"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    out = str(tmp_path / "out")
    assert main(["design", "two_link", "--for", str(path), "-o", out, *QUICK]) == 2
    lines = [x for x in capsys.readouterr().err.splitlines() if x.startswith("excite:")]
    assert len(lines) == 1 and words in lines[0] and str(path) in lines[0]

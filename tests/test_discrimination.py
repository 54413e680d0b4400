"""Designs that discriminate: separations, gradients, explanations of a diagnosis, menu."""

from __future__ import annotations

import dataclasses
import itertools
import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from excite import api
from excite.api.design_result import CellOptions
from excite.api.discriminating_design import read_questions
from excite.cli.main import main
from excite.designer import optimize
from excite.designer.criteria import Criterion
from excite.designer.discrimination import (
    Comparison,
    Explanation,
    RunSettings,
    SeparationObjective,
    WeightedRows,
    separations,
)
from excite.designer.discrimination_design import (
    CandidateExplanation,
    ExplanationSet,
    competing_pairs,
    sampled_motion,
)
from excite.designer.effect_columns import (
    SYMBOLIC_EFFECTS,
    UNKNOWN,
    EffectColumns,
    RobotConstants,
    SymbolicEffect,
    curve_values,
)
from excite.designer.evaluator import Evaluator
from excite.designer.experiment_menu import compute_menu
from excite.designer.explanations import EffectSpecification, stated_factor, symbolic_effect
from excite.designer.options import DesignOptions
from excite.errors import UnusableInput
from excite.robot.inertial_parameters import COULOMB_WIDTH
from excite.robot.limits import Braking, resolve
from excite.robot.robot import load

OPTIONS = DesignOptions(
    criterion=Criterion.D, period=2.0, harmonics=3, samples=60, starts=2, jobs=1
)
PAIR = ("load_friction", "position_friction")


@cache
def setup() -> optimize.DesignSetup:
    robot = load("two_link")
    return optimize.set_up(robot, resolve(robot), OPTIONS)


def constants() -> RobotConstants:
    problem = setup().problem
    p = problem.parameters
    psi = p.nominal.copy()
    psi[p.block("coulomb")], psi[p.block("viscous")] = 2.0, 1.0
    widths = np.full(problem.robot.n, COULOMB_WIDTH)
    return RobotConstants(problem.robot, p, psi, widths, resolve(problem.robot))


def question(*effects: str, joint: int = 0) -> ExplanationSet:
    c = constants()
    forms = [
        symbolic_effect(EffectSpecification(e, None if e == "gravity_tilt" else joint, {}), c)
        for e in effects
    ]
    share = 1.0 / len(forms)
    candidates = tuple(CandidateExplanation(form, None, share) for form in forms)
    pairs = competing_pairs(list(range(len(forms))), [share] * len(forms), lambda a, b: ())
    return ExplanationSet(c, candidates, tuple(pairs))


@cache
def reference():
    return optimize.solve(setup()).motion


def test_separation_is_the_residual_of_least_squares():
    rng = np.random.default_rng(0)
    rows = WeightedRows(rng.normal(size=(40, 5)), rng.normal(size=(40, 6)))
    slices = [slice(0, 2), slice(2, 3), slice(3, 6)]
    form = SymbolicEffect("drag", 0)
    factors = [rng.normal(size=(2, 2)), rng.normal(size=(1, 1)), rng.normal(size=(3, 1))]
    explanations = [Explanation(form, factor, 0.3) for factor in factors]
    comparisons = [
        Comparison(0, 1, (), 0.2),
        Comparison(1, None, (), 0.2),
        Comparison(2, 0, (1,), 0.2),
    ]
    values = separations(rows, slices, explanations, comparisons).values
    for comparison, value in zip(comparisons, values, strict=True):
        others = [*comparison.nuisance, *([] if comparison.rival is None else [comparison.rival])]
        regressor = np.hstack([rows.base, *(rows.columns[:, slices[k]] for k in others)])
        torque = rows.columns[:, slices[comparison.true]] @ factors[comparison.true]
        residual = torque - regressor @ np.linalg.lstsq(regressor, torque, rcond=None)[0]
        assert value == pytest.approx(np.sum(residual**2), rel=1e-9)


@pytest.mark.parametrize("effect", [e for e in SYMBOLIC_EFFECTS if e != "spring"])
def test_gradient_equals_finite_differences(effect: str):
    """Each effect against a spring, which a motion with unequal strokes tells apart."""
    problem = setup().problem
    rng = np.random.default_rng(3)
    try:
        objective = question(effect, "spring").objective(problem, setup().base, reference())
    except UnusableInput:  # the base model reproduces the effect
        assert effect in ("rotor_inertia", "torque_offset", "friction", "payload")
        return
    evaluator = Evaluator(dataclasses.replace(problem, objective=objective))
    x = problem.variables(reference()) + 0.05 * rng.normal(size=problem.size)
    direction = rng.normal(size=problem.size)
    _, gradient = evaluator.objective(x, 1.0)
    step = 2e-7
    ends = [evaluator.objective(x + h * direction, 1.0)[0] for h in (step, -step)]
    assert gradient @ direction == pytest.approx((ends[0] - ends[1]) / (2.0 * step), rel=1e-6)


def nominal_shape(effect: str) -> SymbolicEffect:
    return symbolic_effect(EffectSpecification(effect, 0, {}), constants())


@pytest.mark.parametrize(
    ("effect", "key", "ratio"),
    [
        ("stribeck", "velocity", 1.5),
        ("load_friction", "power", 1.3),
        ("hysteresis", "reach", 1.5),
        ("thermal_drift", "time_constant", 1.5),
    ],
)
def test_a_rival_may_bend_its_curve(effect: str, key: str, ratio: float):
    """An effect against itself with another nonlinear parameter, within its prior."""
    form = nominal_shape(effect)
    other = dataclasses.replace(form, values={**form.values, key: ratio * form.values[key]})
    motion = sampled_motion(setup().problem.robot, setup().problem.parameters, reference())
    settings = RunSettings(setup().base.geometric, np.array([0.6, 0.2]), 40)
    values = []
    for uncertain in (False, True):
        columns = EffectColumns(constants(), [form, other], uncertain_forms=uncertain)
        factor = np.zeros((columns.slices[0].stop, 1))
        factor[0] = 100.0
        explanations = (Explanation(form, factor, 0.5), Explanation(other, factor, 0.5))
        comparison = (Comparison(0, 1, (), 1.0),)
        objective = SeparationObjective(columns, explanations, comparison, settings)
        values.append(objective.separations(motion).item())
    assert 0.0 < values[1] < 0.2 * values[0]


def test_the_form_of_a_rival_is_uncertain_in_units_of_its_size():
    """A large rival bends freely, one that is expected to be small hardly."""
    forms = [nominal_shape("stribeck"), nominal_shape("drag")]
    motion = sampled_motion(setup().problem.robot, setup().problem.parameters, reference())
    settings = RunSettings(setup().base.geometric, np.array([0.6, 0.2]), 40)

    def separation(size: float, *, uncertain: bool = True) -> float:
        columns = EffectColumns(constants(), forms, uncertain_forms=uncertain)
        factors = [np.zeros((place.stop - place.start, 1)) for place in columns.slices]
        factors[0][0], factors[1][0] = 5.0, size
        explanations = tuple(
            Explanation(form, factor, 0.5) for form, factor in zip(forms, factors, strict=True)
        )
        comparison = (Comparison(0, 1, (), 1.0),)
        objective = SeparationObjective(columns, explanations, comparison, settings)
        return objective.separations(motion).item()

    rigid = separation(1e-4, uncertain=False)
    assert separation(1e-4) == pytest.approx(rigid, rel=1e-3)
    values = [separation(size) for size in (1e-4, 0.1, 1.0, 10.0, 1e3)]
    assert all(a > b for a, b in itertools.pairwise(values))


@pytest.mark.parametrize("over_speed", [False, True])
@pytest.mark.parametrize("directed", [False, True])
def test_the_column_of_an_unknown_torque_is_its_curve(over_speed: bool, directed: bool):
    x, y = np.linspace(-2.0, 2.0, 9), np.sin(np.linspace(-2.0, 2.0, 9))
    values = curve_values(x.tolist(), y.tolist(), over_speed=over_speed, directed=directed)
    columns = EffectColumns(constants(), [SymbolicEffect(UNKNOWN, 0, values, 1)])
    motion = sampled_motion(setup().problem.robot, setup().problem.parameters, reference())
    torque = columns.evaluate(motion).columns[:, :, 0]
    expected = np.interp((motion.dq if over_speed else motion.q)[:, 1], x, y)
    if directed:
        expected = expected * np.tanh(motion.dq[:, 0] / COULOMB_WIDTH)
    np.testing.assert_allclose(torque[:, 0], expected, atol=0.05)
    assert not torque[:, 1].any()


@pytest.mark.parametrize("over_speed", [False, True])
def test_gradient_of_an_unknown_torque(over_speed: bool):
    problem, rng = setup().problem, np.random.default_rng(4)
    values = curve_values([-2.0, 0.0, 1.0], [1.0, -2.0, 1.5], over_speed=over_speed, directed=True)
    spring = question("spring")
    candidates = (
        CandidateExplanation(SymbolicEffect(UNKNOWN, 0, values), np.ones((1, 1)), 0.5),
        dataclasses.replace(spring.candidates[0], probability=0.5),
    )
    pairs = tuple(competing_pairs([0, 1], [0.5, 0.5], lambda a, b: ()))
    competing = ExplanationSet(spring.constants, candidates, pairs)
    objective = competing.objective(problem, setup().base, reference())
    evaluator = Evaluator(dataclasses.replace(problem, objective=objective))
    x = problem.variables(reference()) + 0.05 * rng.normal(size=problem.size)
    direction, step = rng.normal(size=problem.size), 2e-7
    _, gradient = evaluator.objective(x, 1.0)
    ends = [evaluator.objective(x + h * direction, 1.0)[0] for h in (step, -step)]
    assert gradient @ direction == pytest.approx((ends[0] - ends[1]) / (2.0 * step), rel=1e-6)


def test_the_search_finds_a_larger_separation_than_a_d_optimal_motion():
    problem, base = setup().problem, setup().base
    designed = question(*PAIR).with_objective(problem, base)
    solved = optimize.solve(dataclasses.replace(setup(), problem=designed))
    objective = designed.objective
    assert isinstance(objective, SeparationObjective) and designed.warm_start is not None
    before, after = (
        objective.separations(sampled_motion(problem.robot, problem.parameters, motion)).min()
        for motion in (designed.warm_start, solved.motion)
    )
    assert after > 1.3 * before
    assert Evaluator(designed).max_constraint_value(problem.variables(solved.motion)) < 1.002


def test_what_the_base_model_reproduces_cannot_be_decided():
    with pytest.raises(UnusableInput, match=r"no motion can decide .* trust a prior"):
        question("rotor_inertia", "torque_offset").objective(
            setup().problem, setup().base, reference()
        )


@pytest.mark.parametrize(
    ("effect", "parameters", "expected"),
    [
        ("load_friction", {"mu": 0.1}, [[0.1]]),
        ("hysteresis", {"amplitude": 2.0, "stiffness": 400.0}, [[2.0]]),
        ("torque_gain", {"gain": 0.8}, [[0.25]]),
        ("torque_saturation", {"loss": 0.2}, [[0.25]]),
        ("asymmetric_viscous", {"positive": 3.0, "negative": 1.0}, [[1.0]]),
        ("friction", {"coulomb": 2.0, "viscous": 1.0}, [[2.0], [1.0]]),
        ("payload", {"mass": 2.0, "com_z": 0.1}, [[2.0], [0.0], [0.0], [0.2]]),
        ("drag", {}, None),
        ("torque_gain", {"gain": 0.0}, None),
    ],
)
def test_stated_parameters_become_coefficients(
    effect: str, parameters: dict[str, float], expected: list[list[float]] | None
):
    specification = EffectSpecification(effect, 0, parameters)
    factor = stated_factor(specification, symbolic_effect(specification, constants()))
    if expected is None:
        assert factor is None
    else:
        np.testing.assert_allclose(factor, expected)


def test_an_equivalent_has_the_size_of_its_finding_where_that_was_found():
    """A cubic friction found at a low speed says little of the torque at a high one."""
    problem, base = setup().problem, setup().base
    cubic = EffectSpecification("nonlinear_viscous", 0, {"coefficient": 1.0, "exponent": 3.0})
    form = symbolic_effect(cubic, constants())
    candidates = (
        CandidateExplanation(form, stated_factor(cubic, form), 0.5),
        CandidateExplanation(nominal_shape("stribeck"), None, 0.5, like=0),
    )
    pairs = tuple(competing_pairs([0, 1], [0.5, 0.5], lambda a, b: ()))
    fast = reference()
    slow = fast.slowed(0.2)
    sampled = sampled_motion(problem.robot, problem.parameters, slow)
    sizes = []
    for given in ((), (sampled,)):
        competing = ExplanationSet(constants(), candidates, pairs, given)
        objective = competing.objective(problem, base, fast)
        sizes.append([float(np.abs(e.factor).max()) for e in objective.explanations])
    assert sizes[0][0] == sizes[1][0] == 1.0
    assert sizes[1][1] < 0.1 * sizes[0][1]


def test_an_unknown_phase_has_the_power_of_its_amplitude():
    specification = EffectSpecification("torque_ripple", 0, {"amplitude": 2.0, "order": 5.0})
    form = symbolic_effect(specification, constants())
    factor = stated_factor(specification, form)
    assert form.values["order"] == 5.0
    np.testing.assert_allclose(np.trace(factor @ factor.T), 2.0**2)


# -- the command -----------------------------------------------------------------------------------


def finding(effect: str, joint: str | None, probability: float, **more: Any) -> dict[str, Any]:
    parameters = {k: {"value": v, "std": 0.1, "unit": ""} for k, v in more.pop("of", {}).items()}
    return {
        "effect": effect,
        "joint": joint,
        "probability": probability,
        "equivalents": more.pop("equivalents", []),
        "parameters": parameters,
        **more,
    }


def write(folder: Path, *findings: dict[str, Any], considered: tuple[Any, ...] = ()) -> Path:
    path = folder / "diagnosis.json"
    document = {
        "schema": "excite.diagnosis/1",
        "verdict": "explained",
        "findings": list(findings),
        "considered": list(considered),
    }
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


LOAD = finding("load_friction", "joint1", 0.9, of={"mu": 0.1}, equivalents=["position_friction"])
QUICK = ("--harmonics", "3", "--period", "2", "--samples", "60", "--starts", "2", "--jobs", "1")


def joints() -> tuple[str, ...]:
    return load("two_link").joints


def test_an_experiment_keeps_all_limits_of_the_design():
    """A repeat at a higher speed would not stop in time before the ends of joint 1."""
    problem, motion = setup().problem, reference()
    calm = dataclasses.replace(motion, sine=0.5 * motion.sine, cosine=0.5 * motion.cosine)
    objective = question("drag", "stribeck").objective(problem, setup().base, calm)
    t, stop = calm.grid(500), (-3.0, 3.0)
    speed, distance = calm.at(t, 1)[:, 0], 2.8 - np.abs(calm.at(t)[:, 0])
    brake = Braking(0.0, float(np.max(speed**2 / distance)), stop)
    obstacles = {}
    for braking in ((None, None), (brake, None)):
        table = dataclasses.replace(resolve(problem.robot), braking=braking)
        limited = optimize.set_up(problem.robot, table, OPTIONS).problem
        menu = compute_menu(limited, table, objective, calm, calm)
        (fast,) = (e for e in menu if "1.3 times the speed" in e.name)
        assert (fast.log_odds is None) == bool(fast.obstacle)
        obstacles[braking] = fast.obstacle
    assert not obstacles[None, None] and "braking limit of 'joint_1'" in obstacles[brake, None]


def test_the_command_reports_comparisons_and_a_menu(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    first, second = joints()
    path = write(
        tmp_path,
        {**LOAD, "joint": first},
        finding("backlash", second, 0.7, of={"width": 1e-3}),
        considered=(finding("stribeck", first, 0.1, of={"amplitude": 1.0, "velocity": 0.1}),),
    )
    out = tmp_path / "out"
    arguments = ["design", "two_link", "--discriminate", str(path), "-o", str(out), "--json"]
    assert main([*arguments, *QUICK]) == 0
    result = json.loads(capsys.readouterr().out)["discrimination"]
    names = {(c["effect"], c["rival"]) for c in result["comparisons"]}
    assert {("load_friction", "position_friction"), ("position_friction", "load_friction")} <= names
    assert ("load_friction", "stribeck") in names and ("stribeck", None) in names
    assert sum(c["weight"] for c in result["comparisons"]) == pytest.approx(1.0)
    smallest = [
        min(c["log_odds"][key] for c in result["comparisons"]) for key in ("d_optimal", "designed")
    ]
    assert smallest[1] > smallest[0] > 0.0
    assert result["linearised"]["position_friction"] == "spatial frequency linearised"
    assert any("backlash" in text for text in result["omitted"])
    menu = {e["experiment"]: e for e in result["menu"]}
    assert len(menu) == 8 and result["recommended"] in menu
    best = [e for e in menu.values() if e["decides"]]
    if best:
        assert menu[result["recommended"]]["seconds"] == min(e["seconds"] for e in best)
    # four times the periods hold more than one repeat
    longer = next(e for name, e in menu.items() if "as long" in name)
    repeat = next(e for name, e in menu.items() if "repeat the D-optimal" in name)
    assert all(a > b for a, b in zip(longer["log_odds"], repeat["log_odds"], strict=True))
    html = (out / "report.html").read_text(encoding="utf-8")
    assert "Which explanation will the recording confirm?" in html
    trajectory = json.loads((out / "trajectory.json").read_text(encoding="utf-8"))
    assert trajectory["design"]["discriminate"] == str(path)
    assert main(["verify", str(out / "trajectory.json")]) == 0


def test_the_text_states_what_was_optimised(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = write(tmp_path, {**LOAD, "joint": joints()[0]})
    out = str(tmp_path / "out")
    assert main(["design", "two_link", "--discriminate", str(path), "-o", out, *QUICK]) == 0
    text = capsys.readouterr().out
    assert "expected share of wrong decisions: " in text
    assert "geometric" not in text


def test_a_finding_that_is_also_an_equivalent_keeps_its_parameters(tmp_path: Path):
    first, _ = joints()
    ripple = {"amplitude": 0.4, "order": 21.0}
    spring = {"stiffness": 3.0}
    path = write(
        tmp_path,
        finding("spring", first, 0.9, of=spring, equivalents=["torque_ripple"]),
        finding("torque_ripple", first, 0.8, of=ripple, equivalents=["spring"]),
    )
    robot = load("two_link")
    questions = read_questions(path, robot, resolve(robot), DesignOptions()).explanations
    wave = next(c for c in questions.candidates if c.form.effect == "torque_ripple")
    assert wave.form.values["order"] == 21.0
    assert wave.factor is not None and np.trace(wave.factor @ wave.factor.T) == pytest.approx(0.16)
    asked = [(c.true, c.rival) for c in questions.comparisons]
    assert len(asked) == len(set(asked)) == 2


def test_the_curve_of_unknown_torque_competes(tmp_path: Path):
    first, second = joints()
    path = write(tmp_path, {**LOAD, "joint": first})
    document = json.loads(path.read_text(encoding="utf-8"))
    response = {"over": f"{second}: speed [rad/s]", "relative": False}
    response |= {"x": [-1.0, 0.0, 1.0], "y": [0.5, 0.0, -0.5]}
    lagging = {"over": "since a load [s]", "relative": True, "x": [0.0, 0.1], "y": [1.0, 0.5]}
    document["unknown"] = [
        {"joint": joint, "probability": 0.8, "where": {"regime": regime, "response": curve}}
        for joint, regime, curve in (
            (first, "speed", response),
            (second, "past load", lagging),
        )
    ]
    path.write_text(json.dumps(document), encoding="utf-8")
    robot = load("two_link")
    questions = read_questions(path, robot, resolve(robot), DesignOptions())
    forms = [candidate.form for candidate in questions.explanations.candidates]
    unknown = next(k for k, form in enumerate(forms) if form.effect == UNKNOWN)
    assert forms[unknown].joint == 0 and forms[unknown].other == 1
    pairs = {(c.true, c.rival) for c in questions.explanations.comparisons}
    assert {(unknown, None), (unknown, 0), (0, unknown)} <= pairs
    (omitted,) = questions.omitted
    assert "no curve over position or speed (past load)" in omitted


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(schema="excite.model/1"), "schema"),
        (lambda d: d["findings"][0].update(joint="elbow"), "no joint 'elbow'"),
        (lambda d: d["findings"][0].update(effect="gremlin"), "no effect 'gremlin'"),
        (lambda d: d["findings"][0].update(probability=1.5), "probability"),
        (lambda d: d.update(findings=[]), "leaves nothing to decide"),
        (lambda d: d["findings"][0].update(effect="backlash", equivalents=[]), "smooth function"),
    ],
)
def test_an_unusable_diagnosis_is_one_line(
    change: Any, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = write(tmp_path, {**LOAD, "joint": joints()[0]})
    document = json.loads(path.read_text(encoding="utf-8"))
    change(document)
    path.write_text(json.dumps(document), encoding="utf-8")
    out = str(tmp_path / "out")
    assert main(["design", "two_link", "--discriminate", str(path), "-o", out, *QUICK]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert words in line and str(path) in line


@pytest.mark.parametrize(
    "more",
    [
        ("--criterion", "d"),
        ("--plain",),
        ("--for", "task.csv"),
        ("--optimise-period", "1,3"),
    ],
)
def test_conflicting_options_are_one_line(
    more: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = write(tmp_path, {**LOAD, "joint": joints()[0]})
    out = str(tmp_path / "out")
    assert main(["design", "two_link", "--discriminate", str(path), "-o", out, *QUICK, *more]) == 2
    assert more[0] in capsys.readouterr().err


def test_every_design_forecasts_what_it_cannot_tell_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    result = api.design(
        "two_link", cell=CellOptions(check=False), period=2.0, harmonics=3, starts=1, jobs=1
    )
    pairs = result.isolability
    odds = [pair.log_odds for pair in pairs]
    assert odds == sorted(odds) and odds[0] >= 0.0
    assert {pair.joint for pair in pairs} == set(joints())
    least = next(p for p in pairs if {p.first, p.second} == {"nonlinear_viscous", "drag"})
    most = next(p for p in pairs if {p.first, p.second} == {"elasticity", "delay"})
    assert least.log_odds < most.log_odds
    assert "Which effects will it not tell apart?" in result.html()


def test_a_discriminating_design_in_python_has_the_starts_of_the_command(tmp_path: Path):
    path = write(tmp_path, {**LOAD, "joint": joints()[0]})
    search = {"period": 2.0, "harmonics": 3, "samples": 60, "iterations": 20, "jobs": 1}
    result = api.design("two_link", discriminate=path, **search)
    assert result.trajectory.design["starts"] == 4

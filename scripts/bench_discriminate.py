#!/usr/bin/env python
"""Measure motions that discriminate between confusable effects: Markdown tables.

--separation: for five robots and the confusable pairs of effects, the separation of a motion
designed to discriminate over those of a D-optimal and of random feasible motions of equal length
under the same limits. Both effects have the same size along the D-optimal motion; the separation of
a pair is the smaller one of both directions. The load effects act at the second joint.

--cases N: concealed robots whose first diagnosis leaves several names open
(`discrimination_cases`): how often one more run along a discriminating, a D-optimal, a random or
the same motion gives the right single name, and how large the evidence is that was expected and
that came.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import discrimination_cases
import numpy as np
from concealed_trial.score import rate
from discrimination_cases import ARMS, outcome, outcome_by_evidence

from excite._types import FloatArray
from excite.designer import initial_guess, optimize
from excite.designer.criteria import Criterion
from excite.designer.discrimination import Comparison, SeparationObjective
from excite.designer.discrimination_design import (
    CandidateExplanation,
    ExplanationSet,
    competing_pairs,
    sampled_motion,
)
from excite.designer.effect_columns import RobotConstants, SymbolicEffect
from excite.designer.evaluator import Evaluator
from excite.designer.explanations import (
    CONVEX_EXPONENT,
    EffectSpecification,
    friction_of,
    symbolic_effect,
)
from excite.designer.optimize import DesignSetup
from excite.designer.options import DesignOptions
from excite.errors import ExciteError, ExciteWarning
from excite.report.figures import svg
from excite.report.figures.drawing import BLUE, GREEN, GREY, ORANGE, axes_grid, render_svg
from excite.report.formatting import power_of_ten
from excite.robot import limits, robot
from excite.robot.inertial_parameters import COULOMB_WIDTH
from excite.trajectory.fourier import FourierSeries

ROBOTS = ("ur10e", "panda", "iiwa14", "tx40", "fr3")
"""Built-in robots of the table."""
JOINT = 1
"""Index of the joint that carries the effects: the shoulder, which carries load."""
FRICTIONS = ("stribeck", "nonlinear_viscous", "hysteresis", "load_friction")
"""Effects that real joints have at once and a diagnosis fits jointly."""
RATIO_RANGE = (1e-3, 1e5)
"""Range of realised over expected evidence in the picture [1]."""
VIEWS: Mapping[str, Callable[[Mapping[str, Any]], str]] = {
    "names": lambda arm: str(arm["outcome"]),
    "evidence": outcome_by_evidence,
    "both": outcome,
}
"""Answers of a diagnosis: its findings, its comparison of evidence, or both where they agree."""
RANDOM_MOTIONS = 9
"""Random feasible motions, of whose separations the median counts."""


def pairs(constants: RobotConstants) -> dict[str, tuple[SymbolicEffect, SymbolicEffect]]:
    """Return the confusable pairs of effects at one joint.

    Seven are those of which one recording cannot split (canonical correlations 0.63-0.99), the
    eighth is the pair that only a fast motion splits: elasticity and delay.

    Args:
        constants: The robot.
    """
    coulomb, viscous = friction_of(constants, JOINT)

    def usual(effect: str) -> SymbolicEffect:
        return symbolic_effect(EffectSpecification(effect, JOINT, {}), constants)

    cubic = symbolic_effect(
        EffectSpecification("nonlinear_viscous", JOINT, {"exponent": CONVEX_EXPONENT}), constants
    )

    def thermal(dry: float, wet: float) -> SymbolicEffect:
        values = {"time_constant": 600.0, "coulomb": dry, "viscous": wet}
        return SymbolicEffect("thermal_drift", JOINT, values)

    return {
        "cubic ~ drag": (cubic, usual("drag")),
        "spring ~ counterbalance": (
            SymbolicEffect("spring", JOINT, {"form": 0.0}),
            SymbolicEffect("spring", JOINT, {"form": 1.0}),
        ),
        "load ~ position friction": (usual("load_friction"), usual("position_friction")),
        "thermal viscous ~ Coulomb": (thermal(0.0, viscous), thermal(coulomb, 0.0)),
        "presliding ~ delay": (usual("hysteresis"), usual("delay")),
        "Stribeck ~ v|v|": (usual("stribeck"), usual("drag")),
        "gain ~ saturation": (usual("torque_gain"), usual("torque_saturation")),
        "elasticity ~ delay": (usual("elasticity"), usual("delay")),
    }


def competition(
    constants: RobotConstants, forms: Sequence[SymbolicEffect], nuisance: bool
) -> tuple[tuple[CandidateExplanation, ...], tuple[Comparison, ...]]:
    """Return the explanations of a pair and its two comparisons.

    Args:
        constants: The robot.
        forms: The pair.
        nuisance: Fit the other frictions of the joint jointly, as a diagnosis does.
    """
    named = {form.effect for form in forms}
    others = [effect for effect in FRICTIONS if effect not in named] if nuisance else []
    frictions = [
        symbolic_effect(EffectSpecification(effect, JOINT, {}), constants) for effect in others
    ]
    candidates = tuple(CandidateExplanation(form, None, 0.5) for form in (*forms, *frictions))
    indices = tuple(range(2, len(candidates)))
    return candidates, tuple(competing_pairs([0, 1], [0.5, 0.5], lambda a, b: indices))


def separation(setup: DesignSetup, objective: SeparationObjective, motion: FourierSeries) -> float:
    """Return the smaller separation of both directions along a motion, densely sampled."""
    problem = setup.problem
    dense = sampled_motion(problem.robot, problem.parameters, motion)
    return float(objective.separations(dense).min())


def random_separations(setup: DesignSetup, objective: SeparationObjective) -> FloatArray:
    """Return the separations of random feasible motions."""
    evaluator, out = Evaluator(setup.problem), []
    for seed in range(RANDOM_MOTIONS):
        rng = np.random.default_rng(seed)
        poses = initial_guess.find_static_poses(evaluator, rng)
        pose = poses[rng.integers(min(len(poses), 1 + len(poses) // 4))]
        x = initial_guess.scale_random_motion(evaluator, pose, rng)
        out.append(separation(setup, objective, setup.problem.fourier(x)))
    return np.array(out)


def compare(name: str, given: argparse.Namespace) -> list[tuple[str, float, float, float, float]]:
    """Return pair, D-optimal, random and discriminating separation, and seconds, for each pair."""
    machine = robot.load(name)
    table = limits.resolve(machine)
    options = DesignOptions(
        criterion=Criterion.D,
        period=given.period,
        harmonics=given.harmonics,
        samples=40 * given.harmonics,
        starts=given.starts,
        seed=given.seed,
        jobs=given.jobs,
    )
    setup = optimize.set_up(machine, table, options)
    begun = time.perf_counter()
    reference = optimize.solve(setup).motion
    reference_time = time.perf_counter() - begun
    standard = setup.problem.parameters
    constants = RobotConstants(
        machine, standard, standard.nominal, np.full(machine.n, COULOMB_WIDTH), table
    )
    out = []
    for title, forms in pairs(constants).items():
        if given.pair not in title:
            continue
        question = ExplanationSet(constants, *competition(constants, forms, given.nuisance))
        objective = question.objective(setup.problem, setup.base, reference)
        problem = dataclasses.replace(setup.problem, objective=objective, warm_start=reference)
        begun = time.perf_counter()
        design = optimize.solve(dataclasses.replace(setup, problem=problem))
        seconds = reference_time + time.perf_counter() - begun
        values = [
            separation(setup, objective, reference),
            float(np.median(random_separations(setup, objective))),
            separation(setup, objective, design.motion),
        ]
        out.append((title, *values, seconds))
    return out


def report_separation(given: argparse.Namespace) -> None:
    """Print the table of separations and the medians of the ratios."""
    head = ["robot", "pair", "random", "D-optimal", "discriminating", "over random", "over D"]
    head.append("design [s]")
    print("| " + " | ".join(head) + " |\n|---|---|" + "---:|" * (len(head) - 2), flush=True)
    ratios, times = [], []
    for name in given.robots or ROBOTS:
        for title, d_optimal, random, best, seconds in compare(name, given):
            ratios.append((best / random, best / d_optimal))
            times.append(seconds)
            cells = [name, title, f"{random:.3g}", f"{d_optimal:.3g}", f"{best:.3g}"]
            cells += [f"{ratio:.2f}" for ratio in ratios[-1]] + [f"{seconds:.1f}"]
            print("| " + " | ".join(cells) + " |", flush=True)
    if not ratios:
        return
    over = np.array(ratios)
    middle, quarters = np.median(over, axis=0), np.quantile(over, (0.25, 0.75), axis=0)
    print(
        f"\nMedian over {len(over)} cases: {middle[0]:.1f} over random "
        f"({quarters[0, 0]:.1f}-{quarters[1, 0]:.1f}), {middle[1]:.2f} over D-optimal "
        f"({quarters[0, 1]:.2f}-{quarters[1, 1]:.2f}); design {np.median(times):.1f} s, "
        f"longest {max(times):.1f} s."
    )


def evidence_pairs(cases: Sequence[dict[str, Any]], arm: str) -> FloatArray:
    """Return expected and realised log Bayes factors of the truth over its rivals, shape (k, 2)."""
    pairs = [
        (entry["arms"][arm]["expected"][rival], value)
        for entry in cases
        for rival, value in entry["arms"][arm]["realised"].items()
        if rival in entry["arms"][arm]["expected"]
    ]
    return np.array(pairs).reshape(-1, 2)


def rate_words(flags: Sequence[bool]) -> str:
    """Return a rate with its 95 % interval by Wilson in percent."""
    result = rate(flags)
    low, high = result["interval"]
    return f"{100 * result['value']:.0f} % ({100 * low:.0f}-{100 * high:.0f})"


def report_cases(given: argparse.Namespace) -> None:
    """Examine concealed cases, then print their outcomes and draw the evidence."""
    robots = given.robots or discrimination_cases.ROBOTS
    discrimination_cases.run(
        given.folder, given.cases, given.seed, given.candidates, robots, given.jobs
    )
    if given.renew:
        discrimination_cases.renew(given.folder, given.jobs)
    entries = discrimination_cases.results(given.folder)
    cases = [entry for entry in entries if entry["status"] == "class"]
    counts = {
        status: sum(entry["status"] == status for entry in entries)
        for status in ("decided", "no class", "error")
    }
    print(
        f"{len(cases)} cases with an open class of {len(entries)} candidates ("
        + ", ".join(f"{count} {status}" for status, count in counts.items())
        + ")\n"
    )
    if not cases:
        return
    heads = ["motions"]
    heads += [f"{view}: {kind}" for view in VIEWS for kind in ("right", "wrong")]
    heads += ["rank correlation", "realised / expected"]
    print("| " + " | ".join(heads) + " |\n|---|" + "---:|" * (len(heads) - 1))
    print("| first alone | " + " | ".join(outcome_rates([e["before"] for e in cases])) + " | | |")
    for arm in ARMS:
        cells = outcome_rates([entry["arms"][arm] for entry in cases])
        pairs = evidence_pairs(cases, arm)
        ranks = np.argsort(np.argsort(pairs, axis=0), axis=0)
        cells.append(f"{np.corrcoef(ranks.T)[0, 1]:.2f}" if len(pairs) > 2 else "")
        cells.append(ratio_words(pairs) if len(pairs) else "")
        print(f"| {arm} | " + " | ".join(cells) + " |")
    picture = given.folder / "evidence.svg"
    picture.write_text(evidence_picture(cases), encoding="utf-8")
    print(f"\nwrote {picture}")


def outcome_rates(arms: Sequence[dict[str, Any]]) -> list[str]:
    """Return the rates of right and of wrong answers by names, by evidence, and by both.

    Args:
        arms: Entry of the diagnosis of each case.
    """
    return [
        rate_words([answer(arm) == kind for arm in arms])
        for answer in VIEWS.values()
        for kind in ("right", "wrong")
    ]


def ratio_words(pairs: FloatArray) -> str:
    """Return median and quartiles of realised over expected evidence."""
    low, middle, high = np.quantile(evidence_ratios(pairs), (0.25, 0.5, 0.75))
    return f"{middle:.2g} ({low:.2g} to {high:.2g})"


def evidence_ratios(pairs: FloatArray) -> FloatArray:
    """Return realised over expected evidence. Shape (k,)."""
    return np.asarray(pairs[:, 1] / np.maximum(pairs[:, 0], 1e-9))


def evidence_picture(cases: Sequence[dict[str, Any]]) -> str:
    """Draw realised over expected evidence of all arms, and how their ratio is distributed."""
    by_arm = {arm: evidence_pairs(cases, arm) for arm in ARMS}
    joined = np.vstack(list(by_arm.values()))
    top = 10.0 ** np.ceil(np.log10(max(float(np.abs(joined).max(initial=1.0)), 10.0)))

    def draw(figure: Any) -> None:
        axes = axes_grid(figure, 1, len(ARMS) + 1, margins=(0.6, 0.15, 0.35, 0.5), gaps=(0.35, 0.2))
        for axis, (arm, pairs) in zip(axes[0], by_arm.items(), strict=False):
            set_signed_decades(axis, top)
            axis.axhline(0.0, color=GREY, linewidth=0.5)
            axis.plot([0.0, top], [0.0, top], color=GREY, linewidth=0.8)
            right = pairs[:, 1] > 0.0
            axis.plot(*pairs[right].T, "o", color=BLUE, markersize=3.5)
            axis.plot(*pairs[~right].T, "x", color=ORANGE, markersize=4.5)
            axis.set_title(arm, loc="left", pad=3)
            axis.set_xlabel("expected ln B")
        axes[0, 0].set_ylabel("realised ln B")
        draw_calibration(axes[0, -1], by_arm)

    title = "Evidence for the truth over its rivals after both recordings; orange: for the rival"
    return svg.standalone(render_svg(title, 2.6, draw))


def set_signed_decades(axis: Any, top: float) -> None:
    """Scale both axes in decades of either sign, x from zero; ticks are plain text."""
    exponents = range(0, round(np.log10(top)) + 1, 2)
    labels = ["0", *(power_of_ten(k) for k in exponents if k)]
    ticks = [0.0, *(10.0**k for k in exponents if k)]
    axis.set_xscale("symlog", linthresh=1.0)
    axis.set_yscale("symlog", linthresh=1.0)
    axis.set_xticks(ticks, labels)
    axis.set_yticks(
        [*(-t for t in ticks[:0:-1]), *ticks], [*(f"−{word}" for word in labels[:0:-1]), *labels]
    )
    axis.set_xlim(0.0, top)
    axis.set_ylim(-top, top)


def draw_calibration(axis: Any, by_arm: Mapping[str, FloatArray]) -> None:
    """Draw the share of pairs whose realised evidence is below a multiple of the expected one.

    Curves begin at the share of pairs whose evidence is for the rival.
    """
    colors = dict(zip(ARMS, (BLUE, GREEN, ORANGE, GREY), strict=True))
    low, high = RATIO_RANGE
    for arm, pairs in by_arm.items():
        ratios = np.sort(np.clip(evidence_ratios(pairs), low, high))
        share = np.arange(1, len(ratios) + 1) / max(len(ratios), 1)
        axis.step(ratios, share, where="post", color=colors[arm], label=arm)
    axis.axvline(1.0, color=GREY, linewidth=0.8)
    axis.set_xscale("log")
    exponents = range(round(np.log10(low)), round(np.log10(high)) + 1, 2)
    axis.set_xticks([10.0**k for k in exponents], [power_of_ten(k) for k in exponents])
    axis.minorticks_off()
    axis.set_xlim(low, high)
    axis.set_ylim(0.0, 1.0)
    axis.set_title("calibration", loc="left", pad=3)
    axis.set_xlabel("realised / expected")
    axis.legend(loc="lower right", handlelength=0.8)


def main() -> int:
    """Run the benchmark; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--separation", action="store_true", help="the table of separations")
    parser.add_argument(
        "--cases", type=int, metavar="N", help="concealed cases with an open class to examine"
    )
    parser.add_argument(
        "--folder",
        type=Path,
        default=Path("out/discrimination"),
        help="results of the cases; a run continues there (default %(default)s)",
    )
    parser.add_argument(
        "--renew",
        action="store_true",
        help="compute the expected evidence of all cases in the folder again",
    )
    parser.add_argument(
        "--candidates", type=int, default=400, help="robots that are tried for the cases at most"
    )
    parser.add_argument(
        "--robots",
        nargs="+",
        metavar="ROBOT",
        help="built-in robots of the table, or of the cases in turn",
    )
    parser.add_argument(
        "--nuisance",
        action="store_true",
        help="fit the other frictions of the joint jointly, as a diagnosis does",
    )
    parser.add_argument("--pair", default="", help="only pairs whose title has this text")
    parser.add_argument(
        "--period", type=float, default=5.0, help="period, of which there are two [s]"
    )
    parser.add_argument("--harmonics", type=int, default=5)
    parser.add_argument("--starts", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=-1, help="processes (-1: one per core)")
    given = parser.parse_args()
    warnings.simplefilter("ignore", ExciteWarning)
    if not given.separation and given.cases is None:
        print(
            "bench_discriminate: nothing to measure; give --separation or --cases", file=sys.stderr
        )
        return 2
    try:
        if given.separation:
            report_separation(given)
        if given.cases is not None:
            report_cases(given)
    except ExciteError as error:
        print(f"bench_discriminate: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

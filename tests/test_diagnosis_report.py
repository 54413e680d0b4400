"""The report of a diagnosis: budget, findings, held-out errors, and the state of doubt."""

from __future__ import annotations

import copy
import dataclasses
import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from synthetic_recordings import (
    FRICTION_WIDTH,
    perturbed_parameters,
    random_fourier,
    synthetic_recording,
    two_link_model,
)
from test_report import answer, check_page, section

from excite.cli.diagnose import diagnosis_text
from excite.diagnosis import diagnosis
from excite.diagnosis.diagnosis import Diagnosis
from excite.diagnosis.diagnosis_file import document, withhold_findings
from excite.diagnosis.estimates import EffectEstimate, Rejection
from excite.diagnosis.probability import Probability
from excite.effects import EFFECTS_BY_NAME
from excite.recordings import Remark, RemarkKind
from excite.report import diagnosis_page
from excite.report import verdict as verdict_module
from excite.report.figures.diagnosis import draw_budget
from excite.report.figures.trajectory import short_names
from excite.report.formatting import number, significant, value_with_error
from excite.report.torque_budget import (
    JointBudget,
    certainty_words,
    joint_budgets,
    parameter_words,
)

DOUBT = {"recording": "out/train.csv", "kind": "torque sign", "text": "the sign is inverted"}


@cache
def diagnosis_of(amplitude: float) -> Diagnosis:
    """Diagnose two links whose second joint has Stribeck friction of an amplitude [N m]."""
    model = two_link_model()
    psi = perturbed_parameters(model.parameters, np.random.default_rng(3))
    both = []
    for seed, name in ((1, "train.csv"), (2, "validate.csv")):
        result = synthetic_recording(model, psi, random_fourier(2, seed), 3.0, 0.0)
        dq = np.gradient(result.q, 1.0 / result.rate, axis=0)[:, 1]
        extra = np.column_stack(
            [0.0 * dq, amplitude * np.exp(-((dq / 0.3) ** 2)) * np.tanh(dq / FRICTION_WIDTH)]
        )
        noise = 0.1 * np.random.default_rng(10 + seed).normal(size=extra.shape)
        both.append(dataclasses.replace(result, source=name, tau=result.torque + extra + noise))
    return diagnosis.diagnose(model.robot, model.parameters, model.base, both[:1], both[1:])


def report_of(
    amplitude: float, remarks: Mapping[str, Sequence[Remark]] | None = None, **changes: Any
) -> str:
    result = diagnosis_of(amplitude)
    return diagnosis_page(result, {**document(result), **changes}, remarks)


def test_finding_is_reported_with_budget_size_and_curve() -> None:
    result, text = diagnosis_of(2.0), report_of(2.0)
    check_page(text)
    stated = document(result)
    finding = next(f for f in stated["findings"] if f["effect"] == "stribeck")
    assert finding["joint"] == "joint_2"
    assert re.findall(r'<section id="(\w+)"', text)[:2] == ["budget", "what"]
    assert text.index('id="budget"') < text.index("<nav")  # the first screen
    budget = section(text, "budget")
    assert "Torque budget of every joint" in budget
    first, second = joint_budgets(stated, result.identified.model.robot)
    assert not first.is_improved and second.is_improved
    assert second.parts[0].effect == "stribeck" and second.parts[0].share > 0.5
    for joint in (first, second):
        assert f"<li>{joint.joint}: error {joint.error}; " in budget.replace("\u00a0", " ")
    assert "Stribeck friction" in second.causes
    findings = section(text, "what").replace("\u00a0", " ")
    assert "Stribeck friction" in findings and "Torque of the effects" in findings
    low, high = finding["evidence"]["severity_interval"]
    assert f"({significant(low)} … {significant(high)})" in findings
    assert significant(second.after, 3) in section(text, "better")
    assert "log Bayes factor" not in re.sub(r"<details.*?</details>", "", text, flags=re.S)


def test_robot_without_mismatch() -> None:
    text = report_of(0.0)
    check_page(text)
    assert document(diagnosis_of(0.0))["verdict"] == "no-mismatch"
    assert "No mismatch: " in text
    assert answer(text, "budget").startswith("From noise")
    assert answer(text, "what").startswith("No finding: ")
    assert "nothing notable is missing" in section(text, "budget")
    assert "--prior" in section(text, "considered")


def test_a_robot_that_no_model_predicts_is_not_without_mismatch() -> None:
    result = diagnosis_of(0.0)
    assert result.verdict == "no-mismatch"
    residual = 2.0 * result.held_out.torque
    held_out = dataclasses.replace(result.held_out, base=residual, final=residual)
    assert dataclasses.replace(result, held_out=held_out).verdict == "unexplained"


def test_doubt_withholds_findings_everywhere() -> None:
    result = diagnosis_of(2.0)
    withheld = withhold_findings(document(result), [DOUBT])
    text = diagnosis_page(result, withheld)
    check_page(text)
    head = text[: text.index('<section id="budget"')]
    assert "Findings are withheld" in head and "train.csv: the sign is inverted" in head
    assert "Partly explained" not in head and "Unexplained" not in head
    shown = re.sub(r"<details.*?</details>", "", text, flags=re.S)
    assert "Stribeck" not in shown and "Torque of the effects" not in shown
    for joint in joint_budgets(withheld, result.identified.model.robot):
        assert joint.after == joint.before and joint.causes == "findings are withheld"
    assert "the base model is saved" in answer(text, "better")
    lines = diagnosis_text(withheld, result.identified.model.robot, [])
    assert "the sign is inverted" in lines and "Stribeck" not in lines


def test_uncertain_effect_of_the_model_is_marked() -> None:
    result = diagnosis_of(2.0)
    stated = document(result)
    doubtful = [f for f in stated["findings"] if f["effect"] == "stribeck"]
    doubtful = [{**f, "reason": "weak evidence"} for f in doubtful]
    certain = [f for f in stated["findings"] if f["effect"] != "stribeck"]
    text = report_of(2.0, findings=certain, considered=[*doubtful, *stated["considered"]])
    assert "perhaps Stribeck friction" in section(text, "budget")
    assert "Pale, “perhaps”" in section(text, "budget")
    considered = section(text, "considered")
    assert "weak evidence, yet in the saved model" in considered
    assert "needs a probability of 0.5" in answer(text, "considered")


def test_parts_that_cancel_are_one() -> None:
    """No part of a budget removes more than the whole error."""
    result = diagnosis_of(2.0)
    stated = copy.deepcopy(document(result))
    shares = {"base_parameters": 2.2, "spring": -1.4, "stribeck": 0.1, "residual": 0.1}
    stated["budget"]["joint_2"] = {name: {"share": x, "std": 0.01} for name, x in shares.items()}
    stated["joints"]["joint_2"] |= {"rmse_before": 1.0, "rmse_after": 0.25}
    stated["findings"] = [{**stated["findings"][0], "effect": "spring", "joint": "joint_2"}]
    causes = joint_budgets(stated, result.identified.model.robot)[1].causes
    assert causes.startswith("base parameters fitted jointly with spring −67 %, ")
    assert "Stribeck friction −8 %" in causes and "hardly" not in causes


def test_small_contributions_are_summed() -> None:
    result = diagnosis_of(2.0)
    stated = copy.deepcopy(document(result))
    stated["budget"]["joint_2"] = {
        name: {"share": share, "std": 0.01}
        for name, share in (("stribeck", 0.9), ("delay", 0.02), ("drag", 0.01), ("residual", 0.07))
    }
    joint = joint_budgets(stated, result.identified.model.robot)[1]
    half = dataclasses.replace(
        joint, before=1.0, after=0.5, torque=2.0, changed=0.0, unknown=False, absent=()
    )
    remains = "; the cause of what remains is not known"
    assert half.causes == f"Stribeck friction −48 %, others −2 %{remains}"
    worse = dataclasses.replace(half, after=1.1, torque=9.0)
    assert (
        "→" in worse.error
        and worse.causes
        == "the saved model predicts this joint worse than the base model because "
        "of Stribeck friction"
    )
    poor = dataclasses.replace(half, after=0.9)
    assert poor.causes.endswith("; the error is 45 % of the torque")
    idle = dataclasses.replace(half, after=1.0, floor=1.0, torque=0.9, is_noise_known=True)
    assert not idle.is_useless and dataclasses.replace(idle, is_noise_known=False).is_useless
    useless = dataclasses.replace(half, torque=0.5).causes
    assert useless.endswith(
        "the base model (200 % of the torque) is worse than predicting no torque"
    )
    absent = dataclasses.replace(half, absent=("hysteresis",)).causes
    assert absent.endswith(f", no change by presliding hysteresis{remains}")
    vain = dataclasses.replace(half, after=0.99, absent=("hysteresis",))
    assert vain.causes.startswith("presliding hysteresis and Stribeck friction do not reduce it")
    nothing = dataclasses.replace(vain, parts=(), absent=())
    assert nothing.causes.startswith("no effect found reduces it")


def test_base_parameters_that_were_fitted_jointly_are_a_part_of_the_budget() -> None:
    result = diagnosis_of(2.0)
    stated = copy.deepcopy(document(result))
    stated["joints"]["joint_2"] |= {"rmse_before": 1.0, "rmse_after": 0.8, "torque_rms": 9.0}
    for key in ("findings", "unknown", "between_recordings"):
        stated[key] = []

    def budget_of(**shares: float) -> JointBudget:
        shares["residual"] = 1.0 - sum(shares.values())
        stated["budget"]["joint_2"] = {k: {"share": v, "std": 0.01} for k, v in shares.items()}
        return joint_budgets(stated, result.identified.model.robot)[1]

    mostly = budget_of(stribeck=0.006, base_parameters=0.354)
    remains = "; the cause of what remains is not known"
    assert mostly.causes == f"base parameters fitted jointly −20 %{remains}"
    against = budget_of(stribeck=0.48, base_parameters=-0.12)
    assert against.causes.startswith("Stribeck friction −27 %, base parameters fitted jointly +7 %")
    stated["verdict"] = "no-mismatch"
    page = diagnosis_page(result, stated)
    banners = page[: page.index('<section id="budget"')]
    assert "no effect is found" in banners and "lacks nothing" not in banners
    above = f"still {significant(against.noise_ratio)} times the noise"
    assert above in banners
    assert "each joint alone" in banners and "nothing is needed" not in banners
    assert answer(page, "what") == "No finding: no known effect explains the error that remains."
    budgets = joint_budgets(stated, result.identified.model.robot)
    assert verdict_module.tone(stated, budgets) == "warn"
    within = [dataclasses.replace(b, after=b.floor, before=b.floor) for b in budgets]
    assert verdict_module.tone(stated, within) == "good"
    assert verdict_module.verdict_words(stated, within).startswith("the base model lacks nothing")
    stated["undecided_between_recordings"] = [
        {"recording": "short.csv", "joint": "joint_1", "seconds": 6.0}
    ]
    assert verdict_module.next_words(stated, within) == verdict_module.LONGER
    weak = [dataclasses.replace(b, torque=2.0 * b.floor) for b in within]
    assert verdict_module.use_words(weak).endswith("is up to 50 % of the torque at both joints")
    useless = [budgets[0], dataclasses.replace(against, torque=0.5)]
    assert verdict_module.tone(stated, useless) == "bad"
    assert "no model fits joint_2" in verdict_module.verdict_words(stated, useless)
    assert verdict_module.use_words(useless).startswith("none")
    assert "order and signs of the joints" in verdict_module.next_words(stated, useless)
    fast = [dataclasses.replace(b, speed_ratio=3.0) for b in budgets]
    assert verdict_module.verdict_words(stated, fast).startswith("no effect is found")
    printed = diagnosis_text(stated, result.identified.model.robot, [])
    assert above in printed
    assert "base parameters fitted jointly" in draw_budget([mostly])
    assert "base parameters fitted jointly" not in draw_budget([against])


def test_alternatives_come_with_the_experiment_that_separates_them() -> None:
    stated = document(diagnosis_of(2.0))
    changes = {"effect": "hysteresis", "equivalents": ["delay"], "rivals": []}
    first = {**stated["findings"][0], **changes}
    text = report_of(2.0, findings=[first])
    assert "or delay" in section(text, "what")
    experiments = section(text, "next")
    assert "To tell apart delay and presliding hysteresis (joint_2)" in experiments
    assert "strokes of many small amplitudes" in experiments and "jerky" in experiments


def test_unknown_torque_and_session_changes_have_sections() -> None:
    unknown = {
        "joint": "joint_1",
        "where": {
            "statement": "",
            "regime": "past load",
            "response": {
                "over": "since a load [s]",
                "relative": True,
                "x": [0.0, 1.0],
                "y": [1, 0],
            },
        },
        "share": 0.3,
        "too_small": ["spring"],
        "probability": 0.8,
        "z_score": None,
        "experiment": "a sharp stop",
    }
    change = {"value": 0.2, "std": 0.05, "unit": "N m", "relative": 0.5}
    session = {"recording": "out/validate.csv", "joint": "joint_2", "coulomb": change}
    session |= {"error_share": 0.9, "error_share_before": 0.9}
    session |= {"viscous": {**change, "relative": 1e5}, "offset": change}
    changes = {"unknown": [unknown], "between_recordings": [session], "verdict": "partly-explained"}
    text = report_of(2.0, **changes)
    check_page(text)
    assert "30 % of the remaining squared error" in section(text, "unknown").replace("\u00a0", " ")
    assert "Spring would explain a part, but is too small to be sure of" in section(text, "unknown")
    assert "a sharp stop" in section(text, "next")
    row = section(text, "changes").replace("\u00a0", " ")
    assert "0.200 ± 0.050 N m (+50 %)" in row and "e+" not in row and "10000000" not in row
    lines = diagnosis_text(
        {**document(diagnosis_of(2.0)), **changes}, diagnosis_of(2.0).identified.model.robot, []
    )
    assert "30 % of the remaining squared error, by past load" in lines
    banners = text[: text.index('<section id="budget"')]
    assert "torque at joint_1 repeats with the motion" in banners
    assert "Use: " in banners and "model.json" in banners
    assert "coulomb 0.200 ± 0.050 N m (+50 %)" in lines


def test_error_by_a_change_between_recordings_is_said_first() -> None:
    result = diagnosis_of(0.0)
    stated = copy.deepcopy(document(result))
    change = {"value": -0.2, "std": 0.01, "unit": "N m", "relative": -0.15}
    stated["between_recordings"] = [
        {
            "recording": "out/validate.csv",
            "joint": "joint_2",
            "error_share": 0.96,
            "error_share_before": 0.9,
            **dict.fromkeys(("coulomb", "viscous", "offset"), change),
        }
    ]
    for key in ("rmse_before", "rmse_after"):
        stated["joints"]["joint_2"][key] = 10.0 * stated["joints"]["joint_2"]["noise_floor"]
    robot = result.identified.model.robot
    joint = joint_budgets(stated, robot)[1]
    expected = "friction or offset changed between the recordings: 96 % of its square"
    assert joint.causes == expected and expected in diagnosis_text(stated, robot, [])
    assert np.isclose(joint.unchanged, 0.2 * joint.after)
    text = diagnosis_page(result, stated)
    check_page(text)
    banners = text[: text.index('<section id="budget"')]
    assert "most of the error of joint_2 is friction or offset that changed" in banners
    assert "Next: warm up alike" in banners and "in one session" in section(text, "next")
    assert "in one session" not in report_of(0.0)
    # 8 → 10 in noise floors, and 2.5 → 2 without the change
    stated["joints"]["joint_2"]["rmse_before"] *= 0.8
    worse = joint_budgets(stated, robot)[1]
    assert "→" in worse.error and worse.causes == expected
    assert "with care" not in diagnosis_page(result, stated)
    stated["between_recordings"][0]["error_share_before"] = 0.99
    assert "worse than the base model" in joint_budgets(stated, robot)[1].causes
    assert "with care" in diagnosis_page(result, stated)


def test_effects_that_are_no_findings_have_reasons() -> None:
    result = diagnosis_of(2.0)
    stated = document(result)
    assert all(entry["reason"] for entry in stated["considered"])
    assert all("reason" not in finding for finding in stated["findings"])
    effect = next(e for e in result.effects if e.effect == "stribeck" and e.needed)

    (shape,) = effect.models
    spring = (dataclasses.replace(shape, definition=EFFECTS_BY_NAME["spring"]),)

    def changed(probable: Probability, **evidence: Any) -> EffectEstimate:
        return dataclasses.replace(effect, is_in_model=False, probable=probable, **evidence)

    sure = Probability(0.9)
    assert changed(sure, size=0.1).rejection == Rejection.TOO_SMALL
    assert changed(sure, size=2.0).rejection == Rejection.EXPLAINED_AS_WELL
    assert changed(Probability(0.01)).rejection == Rejection.WEAK_FRICTION
    for probable, expected in (
        (Probability(0.01), Rejection.WEAK_EVIDENCE),
        (Probability(0.9, share=0.1), Rejection.EXPLAINED_AS_WELL),
        (Probability(0.9, size=0.1), Rejection.TOO_SMALL),
        (Probability(0.9, known=0.1), Rejection.NEXT_TO_UNKNOWN),
    ):
        assert changed(probable, models=spring).rejection == expected
    spoiling = changed(sure, size=0.1, spoils_prediction=True)
    assert spoiling.rejection == Rejection.SPOILS_PREDICTION


def test_exponent_that_may_be_one_has_no_value() -> None:
    result = diagnosis_of(2.0)
    stribeck = result.findings[0]
    definition = EFFECTS_BY_NAME["nonlinear_viscous"]
    renamed = (dataclasses.replace(stribeck.models[0], definition=definition),)
    effect = dataclasses.replace(stribeck, models=renamed)
    stated = []
    for std in (0.05, 0.2):
        parameters = {"coefficient": (5.0, 1.0), "exponent": (0.8, std)}
        changed = dataclasses.replace(effect, parameters=parameters)
        finding = document(dataclasses.replace(result, effects=(changed,)))["findings"][0]
        stated.append(set(finding["parameters"]))
    assert stated == [{"coefficient", "exponent"}, set()]


def test_delay_is_said_in_words() -> None:
    early = {"seconds": {"value": -0.000808, "std": 2e-5, "unit": "s"}}
    assert parameter_words(early) == "torque 0.808 ± 0.020 ms before position"
    late = {"seconds": {"value": 0.004, "std": 0.001, "unit": "s"}}
    assert parameter_words(late) == "torque 4.0 ± 1.0 ms after position"


def test_torque_that_repeats_has_no_probability_which_is_not_calibrated():
    assert certainty_words({"probability": 0.99, "z_score": 12.3}) == "12 × its standard error"
    assert certainty_words({"probability": 0.8, "z_score": None}) == "probability 0.80"


def test_shortened_names_stay_different() -> None:
    names = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
    assert short_names(names, 14) == ["shoulder_pan", "shoulder_lift", "elbow"]
    assert short_names(["a1", "b2"], 14) == ["a1", "b2"]
    of_robot = [f"AR5-07R_arm_joint_{i}" for i in range(3)]
    assert short_names(of_robot, 14) == ["arm_joint_0", "arm_joint_1", "arm_joint_2"]
    assert short_names(of_robot, 10) == ["joint_0", "joint_1", "joint_2"]
    assert short_names(of_robot[:1], 14) == ["AR5-07R…oint_0"]
    assert short_names(["robot1_knee_a", "robot1_knee_b"], 10) == ["knee_a", "knee_b"]
    legs = [f"{side}_shoulder_{way}" for side in ("left", "right") for way in ("pitch", "roll")]
    assert max(map(len, short_names(legs, 8))) == 8
    alike = [f"arm_{side}_of_the_robot_{k}" for side in ("left", "right") for k in "12"]
    assert len(set(short_names(alike, 10))) == 4


def test_text_of_the_command() -> None:
    result = diagnosis_of(2.0)
    lines = diagnosis_text(document(result), result.identified.model.robot, [Path("report.html")])
    verdict, summary, *parts = lines.split("\n\n")
    assert verdict == f"verdict: {document(result)['verdict']}"
    assert summary.startswith("Stribeck friction (joint_2) explains") and "\nNext: " in summary
    joints, findings = (part.splitlines()[1:] for part in parts[:2])
    assert [line.split()[0] for line in joints] == ["joint_1", "joint_2"]
    stated = {(f["joint"] or "whole") for f in document(result)["findings"]}
    assert stated == {line.split()[0] for line in findings}
    assert any("Stribeck" in line and "× residual" in line for line in findings)
    withheld = withhold_findings(document(result), [DOUBT])
    doubted = diagnosis_text(withheld, result.identified.model.robot, [Path("report.html")])
    assert "The effects below" not in doubted and "train.csv: the sign is inverted" in doubted


def test_remarks_are_listed_and_markup_is_escaped() -> None:
    assert "the data-quality checks have no remark" in answer(report_of(0.0), "made")
    result = diagnosis_of(0.0)
    model = result.identified.model
    evil = dataclasses.replace(model.robot, name="<b>x</b>")
    changed = dataclasses.replace(result.identified, model=dataclasses.replace(model, robot=evil))
    text = diagnosis_page(
        dataclasses.replace(result, identified=changed),
        document(result),
        {"a.csv": [Remark(RemarkKind.GAP, "a gap of 12 rows", repaired=True)]},
    )
    assert "1 remark" in answer(text, "made") and "a gap of 12 rows" in section(text, "made")
    assert "<b>x</b>" not in text and "&lt;b&gt;x" in text


def test_same_input_gives_the_same_bytes() -> None:
    assert report_of(2.0) == report_of(2.0)


def test_numbers() -> None:
    assert (number(0.005), number(-0.25), number(20.0)) == ("0.005", "−0.25", "20")
    assert [significant(x) for x in (0.2, 0.996, -15.2, 163.0)] == ["0.20", "1.0", "−15", "160"]
    assert value_with_error(1748.2, 781.0, "N m/rad") == "1750 ± 780 N m/rad"
    assert value_with_error(0.2634, 0.0971, "1") == "0.263 ± 0.097"

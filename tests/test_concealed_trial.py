"""The concealed trial: cases do not reveal what they hide, and answers are scored correctly."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from concealed_trial import case_plan, commitment, generate_cases, run, run_analyst
from concealed_trial.case_plan import CasePlan, CaseSpec
from concealed_trial.run_analyst import Analyst
from concealed_trial.score import Mark, are_equivalent, calibration, compare_answer, score

from excite.errors import UnusableInput

SCRIPT = Path(__file__).parents[1] / "scripts" / "concealed_trial"


# -- the plan ---------------------------------------------------------------------------------


def test_plan_of_300_cases_covers_all_nuisances_and_effects():
    specs = CasePlan(300, 1, "scored").specs()
    nulls = [s for s in specs if s.category == "null"]
    assert len(specs) == 300 and len(nulls) >= 60
    assert {s.nuisance for s in nulls} == set(case_plan.NUISANCES)
    singles = [s.names[0] for s in specs if s.category == "single"]
    assert set(singles) == set(case_plan.REFIT_EFFECTS + case_plan.PRIOR_ONLY_EFFECTS)
    assert {s.severities[0] for s in specs if s.severities} == {1.0, 3.0, 10.0, 30.0}
    assert {s.category for s in specs} == {"null", "single", "pair", "out_of_catalogue"}
    assert len({s.name for s in specs}) == 300 and all(len(s.name) == 6 for s in specs)
    # a prior does not reveal whether an effect is hidden
    share = [
        np.mean([s.trusted for s in specs if (s.category == "null") == null])
        for null in (True, False)
    ]
    assert share[0] == pytest.approx(share[1], abs=0.02)


def test_tuning_and_scored_cases_share_no_seed_and_no_name():
    tuning, scored = CasePlan(300, 1, "tuning").specs(), CasePlan(300, 1, "scored").specs()
    assert not {s.seed for s in tuning} & {s.seed for s in scored}
    assert len({s.name for s in tuning} & {s.name for s in scored}) <= 1
    assert {s.family for s in tuning} == {"tuning"} and {s.family for s in scored} == {"scored"}


def test_metadata_of_a_case_does_not_predict_whether_it_is_null():
    """Nearest neighbours on all visible metadata, trained and tested on 1000 cases each."""
    specs = CasePlan(2000, 4, "scored").specs()
    metadata = np.array(
        [
            [s.number % 1000, int(s.name, 16), case_plan.ROBOTS.index(s.robot), s.trusted]
            for s in specs
        ],
        float,
    )
    metadata = (metadata - metadata.mean(axis=0)) / metadata.std(axis=0)
    null = np.array([s.category == "null" for s in specs])
    distance = np.square(metadata[1000:, None] - metadata[None, :1000]).sum(axis=2)
    votes = null[np.argsort(distance, axis=1)[:, :25]].mean(axis=1)
    tried = null[1000:]
    # area under the curve: probability that a null case gets more votes than another
    area = (votes[tried][:, None] > votes[~tried]).mean() + 0.5 * (
        votes[tried][:, None] == votes[~tried]
    ).mean()
    assert 0.44 < area < 0.56


# -- three small cases, generated once -------------------------------------------------------------


def case_spec(
    number: int,
    name: str,
    category: str,
    names: tuple[str, ...] = (),
    trusted: bool = False,
    nuisance: str = "none",
) -> CaseSpec:
    return CaseSpec(
        number,
        name,
        "two_link",
        category,
        trusted,
        names,
        (10.0,) * len(names),
        nuisance,
        "tuning",
        100 + number,
    )


SPECS = (
    case_spec(0, "0a0a0a", "null", nuisance="coarse_encoder"),
    case_spec(1, "0b0b0b", "single", ("load_friction",)),
    case_spec(2, "0c0c0c", "single", ("payload",), trusted=True),
)


class FixedPlan(CasePlan):
    def specs(self) -> list[CaseSpec]:
        return list(SPECS)


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> run.TrialFolder:
    trial = run.TrialFolder(tmp_path_factory.mktemp("trial"))
    run.conceal(trial, FixedPlan(3, 0, "tuning"), 1, lambda _: None)
    run.answer(trial, [run_analyst.baseline_analysts()], 1, lambda _: None)
    return trial


def test_files_of_all_cases_look_the_same(trial):
    def looks(name: str) -> list[tuple[str, int, float]]:
        return sorted(
            (p.name, p.stat().st_size, p.stat().st_mtime)
            for p in (trial.cases / name).iterdir()
            if p.suffix != ".urdf"
        )

    first, second, third = (looks(s.name) for s in SPECS)
    assert first == second == [entry for entry in third if entry[0] != "prior.json"]
    sidecars = {
        (trial.cases / s.name / f"{which}.json").read_text()
        for s in SPECS
        for which in ("train", "validate")
    }
    assert (
        len(
            {
                json.dumps({k: v for k, v in json.loads(text).items() if k != "periodic"})
                for text in sidecars
            }
        )
        == 1
    )
    assert not any(
        "truth" in p.name or "key" in p.name
        for s in SPECS
        for p in (trial.cases / s.name).iterdir()
    )


def test_cases_are_reproducible_byte_for_byte(trial):
    again = generate_cases.analyst_files(generate_cases.generate_case(SPECS[1], run.MODELS))
    assert all(
        (trial.cases / SPECS[1].name / name).read_text(encoding="utf-8") == text
        for name, text in again.items()
    )


def test_an_invisible_effect_is_drawn_without_the_nuisance():
    """A slow robot has no observable drag."""
    case = generate_cases.generate_case(
        case_spec(3, "0d0d0d", "single", ("drag",), nuisance="poor_excitation"), run.MODELS
    )
    assert case.spec.nuisance == "none" and case.hidden[0][1] > generate_cases.LEAST_SEVERITY
    assert (
        generate_cases.draw_case(
            case_spec(3, "0d0d0d", "single", ("drag",), nuisance="poor_excitation"), run.MODELS, 0.0
        ).hidden[0][1]
        < generate_cases.LEAST_SEVERITY
    )


def test_changed_session_changes_friction_only():
    plain, later = (
        generate_cases.generate_case(case_spec(4, "0e0e0e", "null", nuisance=nuisance), run.MODELS)
        for nuisance in ("none", "changed_session")
    )
    assert plain.sessions[0].recording.to_csv() == later.sessions[0].recording.to_csv()
    before, after = (case.sessions[1].robot.actuators for case in (plain, later))
    for kind in ("coulomb", "viscous"):
        factor = getattr(after, kind) / getattr(before, kind)
        assert (
            np.all((np.abs(factor - 1.0) > 0.05) & (np.abs(factor - 1.0) < 0.4))
            and len(set(np.sign(factor - 1.0))) == 1
        )
    assert np.array_equal(before.inertia, after.inertia) and np.array_equal(
        before.offset, after.offset
    )


def test_change_between_sessions_does_not_count_as_unknown_physics():
    def mark_of(regime: str) -> Mark:
        answer = {
            "findings": [],
            "unknown": [{"joint": "joint_1", "where": {"regime": regime}}],
            "joints": {},
        }
        case = {
            "spec": {"category": "null", "nuisance": "changed_session", "trusted": False},
            "effects": [],
            "joints": [],
        }
        return compare_answer(case, {"answer": answer, "seconds": 1.0})

    assert mark_of("recording").has_no_finding and not mark_of("power").has_no_finding


def test_ground_truth_is_committed_and_a_change_voids_the_trial(trial, tmp_path):
    published = trial.published_hash()
    assert commitment.digest(trial.key / "key.json") == published and len(published) == 64
    cases = commitment.open_ground_truth(trial.key, published)
    assert cases["0b0b0b"]["effects"][0]["effect"] == "load_friction"
    (tmp_path / "key.json").write_text(
        (trial.key / "key.json").read_text().replace("load_friction", "drag")
    )
    with pytest.raises(UnusableInput, match="void"):
        commitment.open_ground_truth(tmp_path, published)


def test_interrupted_trial_resumes(trial, tmp_path):
    import shutil

    copy = run.TrialFolder(tmp_path / "copy")
    shutil.copytree(trial.root, copy.root)
    (copy.answers / "greedy" / "0b0b0b.json").unlink()
    answer_with: list[str] = []
    run.conceal(copy, FixedPlan(3, 0, "tuning"), 1, answer_with.append)
    run.answer(copy, [run_analyst.baseline_analysts()], 1, answer_with.append)
    assert len(answer_with) == 1 and answer_with[0].startswith("answered 2 of 3")
    assert copy.commitment.read_text() == trial.commitment.read_text()


def test_answer_before_the_commitment_is_refused(tmp_path):
    with pytest.raises(UnusableInput, match="not committed"):
        run.answer(run.TrialFolder(tmp_path), [run_analyst.baseline_analysts()], 1, lambda _: None)


def test_analyst_sees_a_copy_of_the_case_and_nothing_else(trial, tmp_path):
    code = (
        "import sys, json, os; from pathlib import Path; folder = Path(sys.argv[1]);"
        "names = sorted(str(p.relative_to(folder.parent)) for p in folder.parent.rglob('*'));"
        "document = dict(findings=[], unknown=[], joints={}, seen=names, cwd=os.getcwd());"
        "Path(sys.argv[2], 'diagnosis.json').write_text(json.dumps(document))"
    )
    (tmp_path / "spy.py").write_text(code)
    spy = Analyst(("spy",), f"{sys.executable} {tmp_path / 'spy.py'} {{case}} {{out}}")
    assert run_analyst.ask(spy, trial.cases / "0c0c0c", tmp_path / "answers") is not None
    answer = json.loads((tmp_path / "answers" / "spy" / "0c0c0c.json").read_text())["answer"]
    files = [
        f"case/{name}"
        for name in (
            "prior.json",
            "robot.urdf",
            "train.csv",
            "train.json",
            "validate.csv",
            "validate.json",
        )
    ]
    assert answer["seen"] == ["case", *files, "out"] and "0c0c0c" not in answer["cwd"]


def test_failing_analyst_counts_as_no_answer(trial, tmp_path):
    broken = Analyst(("broken",), f"{sys.executable} -c 'raise SystemExit(3)'")
    run_analyst.ask(broken, trial.cases / "0a0a0a", tmp_path)
    entry = json.loads((tmp_path / "broken" / "0a0a0a.json").read_text())
    comparison = compare_answer(
        commitment.open_ground_truth(trial.key, trial.published_hash())["0a0a0a"], entry
    )
    assert (
        not comparison.answered
        and not comparison.has_no_finding
        and score([comparison])["false_alarms"]["value"] == 1.0
    )


def test_baselines_write_diagnoses_and_greedy_search_solves_a_simple_case(trial):
    for name in run_analyst.BASELINES:
        document = json.loads((trial.answers / name / "0b0b0b.json").read_text())["answer"]
        assert document["schema"] == "excite.diagnosis/1"
        assert set(document["joints"]) == {"joint_1", "joint_2"}
    greedy = json.loads((trial.answers / "greedy" / "0b0b0b.json").read_text())["answer"]
    assert "load_friction" in {f["effect"] for f in greedy["findings"]}
    assert json.loads((trial.answers / "greedy" / "0c0c0c.json").read_text())["answer"]["findings"]
    stribeck = json.loads((trial.answers / "stribeck" / "0a0a0a.json").read_text())["answer"]
    assert [f["effect"] for f in stribeck["findings"]] == ["stribeck"]


def test_oracle_has_lower_error_than_the_base_model(trial):
    cases = commitment.open_ground_truth(trial.key, trial.published_hash())
    held = cases["0b0b0b"]["held_out"]
    assert max(held["before"]) > 2.0 * max(held["oracle"])
    null = cases["0a0a0a"]["held_out"]
    assert null["before"] == null["oracle"]


def test_report_has_tables_and_figures(trial):
    text = run.report(trial)
    assert "false alarms where nothing is hidden" in text and "greedy" in text
    document = json.loads((trial.root / "score.json").read_text())
    alarms = document["scores"]["stribeck"]["false_alarms"]
    assert (alarms["value"], alarms["count"]) == (1.0, 1) and alarms["interval"][
        0
    ] == pytest.approx(0.2065, abs=1e-3)
    assert document["confusion"]["stribeck"]["load_friction"] == {"stribeck": 1}
    for name in ("confusion.svg", "reliability.svg"):
        assert "<svg" in (trial.root / name).read_text()
    assert "ground truth committed: " in (trial.root / "log.txt").read_text()


# -- marks ------------------------------------------------------------------------------------


def finding(
    effect: str, joint: str | None, probability: float = 0.9, **more: object
) -> dict[str, object]:
    return {
        "effect": effect,
        "joint": joint,
        "probability": probability,
        "equivalents": [],
        "parameters": {},
        **more,
    }


def case_with(category: str, *effects: dict[str, object]) -> dict[str, object]:
    return {
        "spec": {"category": category, "nuisance": "none", "trusted": False},
        "joints": ["a"],
        "effects": [
            {"outsider": False, "severity": 5.0, "details": {}, "parameters": {}, **e}
            for e in effects
        ],
        "held_out": {"before": [3.0], "oracle": [1.0], "noise": [1.0]},
    }


def answer_with(
    *findings: dict[str, object], unknown: tuple[object, ...] = (), after: float = 2.0
) -> dict[str, object]:
    answer = {
        "findings": list(findings),
        "unknown": list(unknown),
        "joints": {"a": {"rmse_after": after}},
    }
    return {"seconds": 1.0, "answer": answer}


def test_mark_compares_effect_joint_parameters_and_gain():
    case = case_with(
        "single",
        {"effect": "drag", "joint": "a", "parameters": {"coefficient": {"value": 2.0, "unit": ""}}},
    )
    comparison = compare_answer(
        case,
        answer_with(
            finding("drag", "a", parameters={"coefficient": {"value": 2.2, "std": 0.2, "unit": ""}})
        ),
    )
    assert comparison.first == "drag" and comparison.joint
    assert comparison.errors == (("drag.coefficient", pytest.approx(0.1), True),)
    assert comparison.gain == pytest.approx((9.0 - 4.0) / (9.0 - 1.0))
    assert not compare_answer(case, answer_with(finding("drag", "b"))).joint
    assert (
        score([compare_answer(case, answer_with(finding("nonlinear_viscous", "a")))])[
            "right_first"
        ]["value"]
        == 1.0
    )


def test_no_finding_is_right_for_null_cases_only():
    null, single = case_with("null"), case_with("single", {"effect": "drag", "joint": "a"})
    assert score([compare_answer(null, answer_with())])["false_alarms"]["value"] == 0.0
    assert (
        score([compare_answer(null, answer_with(unknown=({"joint": "a"},)))])["false_alarms"][
            "value"
        ]
        == 1.0
    )
    assert score([compare_answer(single, answer_with())])["abstained"]["value"] == 1.0
    assert (
        score([compare_answer(single, answer_with(unknown=({"joint": "a"},)))])["abstained"][
            "value"
        ]
        == 0.0
    )


def test_scores_of_equivalents_pairs_unknowns_and_contacts():
    within = compare_answer(
        case_with("single", {"effect": "delay", "joint": "a"}),
        answer_with({**finding("hysteresis", "a"), "equivalents": ["delay"]}),
    )
    figures = score([within])
    assert (
        figures["right_first"]["value"],
        figures["within_equivalents"]["value"],
        figures["equivalents"]["value"],
    ) == (0.0, 1.0, 1.0)
    both = case_with(
        "pair", {"effect": "delay", "joint": "a"}, {"effect": "stribeck", "joint": "a"}
    )
    assert (
        score(
            [
                compare_answer(
                    both, answer_with(finding("stribeck", "a"), finding("delay", "a", 0.6))
                )
            ]
        )["both_of_two"]["value"]
        == 1.0
    )
    assert (
        score([compare_answer(both, answer_with(finding("stribeck", "a")))])["both_of_two"]["value"]
        == 0.0
    )
    odd = case_with("out_of_catalogue", {"effect": "sloshing", "joint": "a", "outsider": True})
    assert (
        score([compare_answer(odd, answer_with(unknown=({"joint": "a"},)))])["unknown_where_it_is"][
            "value"
        ]
        == 1.0
    )
    details = {"start": {"value": 2.0}, "end": {"value": 4.0}}
    touch = case_with("single", {"effect": "contact", "joint": "a", "details": details})
    assert compare_answer(
        touch, answer_with(finding("contact", "a", where={"time": [3.0, 5.0]}))
    ).overlap == pytest.approx(1.0 / 3.0)


@pytest.mark.parametrize(
    "broken",
    [None, [], {}, {"error": "x"}, {"findings": [{"effect": 1}], "unknown": [], "joints": {}}],
)
def test_malformed_diagnosis_counts_as_no_answer(broken):
    assert not compare_answer(case_with("null"), {"seconds": 0.0, "answer": broken}).answered


def test_calibration_error_of_certain_answers():
    plain = compare_answer(
        case_with("single", {"effect": "drag", "joint": "a"}),
        answer_with(finding("drag", "a", 1.0)),
    )
    wrong: Mark = replace(plain, truth=("delay",))
    assert calibration([plain])["error"] == 0.0
    assert calibration([plain, wrong])["error"] == pytest.approx(0.5)


def test_equivalent_effects_of_the_contract():
    assert are_equivalent("drag", "nonlinear_viscous") and not are_equivalent("drag", "delay")


# -- the script -------------------------------------------------------------------------------


def test_wrong_use_prints_one_line(tmp_path):
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "run", "--analyst", "greedy=x", "-o", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (
        done.returncode == 2
        and len(done.stderr.strip().splitlines()) == 1
        and "must read NAME=COMMAND" in done.stderr
    )

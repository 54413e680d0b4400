"""The concealed trial: cases do not reveal what they hide, and answers are scored correctly."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from concealed_trial import case_plan, commitment, generate_cases, run, run_analyst, table
from concealed_trial import unique_severity as unique
from concealed_trial.case_plan import CasePlan, CaseSpec, out_of_catalogue_names
from concealed_trial.run_analyst import Analyst
from concealed_trial.score import (
    BLIND_EFFECTS,
    Mark,
    are_equivalent,
    blind_answer,
    compare_answer,
    probability_score,
    rate,
    score,
)

from excite.errors import UnusableInput

SCRIPT = Path(__file__).parents[1] / "scripts" / "concealed_trial"


# -- the plan ---------------------------------------------------------------------------------


def test_plan_is_reproducible_and_covers_all_groups_nuisances_and_effects():
    specs = CasePlan(300, 1, "scored").specs()
    assert specs == CasePlan(300, 1, "scored").specs() and len({s.name for s in specs}) == 300
    counts = Counter(s.category for s in specs)
    assert counts["single"] + counts["pair"] == 90
    assert [counts[k] for k in ("dense", "half_dense", "null", "out_of_catalogue")] == [
        75,
        45,
        60,
        30,
    ]
    nulls = [s for s in specs if s.category == "null"]
    assert {s.nuisance for s in nulls} == set(case_plan.NUISANCES)
    assert {s.training for s in nulls} == {1, 2} and any(s.trusted for s in nulls)
    special = [s.names[0] for s in specs if s.category == "dense" and s.names]
    assert set(special) == set(case_plan.SPECIAL_EFFECTS) and len(special) == 38
    singles = {s.names[0] for s in specs if s.category == "single"}
    assert singles == set(case_plan.REFIT_EFFECTS + case_plan.PRIOR_ONLY_EFFECTS)
    dense = [s for s in specs if s.is_dense]
    assert {s.robot for s in dense} == set(case_plan.DENSE_ROBOTS)
    assert {level for s in dense for level in s.severities} == {3.0, 10.0}
    only = CasePlan(10, 1, "tuning", ("half_dense",)).specs()
    assert {s.category for s in only} == {"half_dense"} and len(only) == 10


def test_tuning_and_scored_cases_share_no_seed_and_no_form_outside_the_catalogue():
    tuning, scored = CasePlan(300, 1, "tuning").specs(), CasePlan(300, 1, "scored").specs()
    assert not {s.seed for s in tuning} & {s.seed for s in scored}
    names = [set(out_of_catalogue_names(family)) for family in ("tuning", "scored")]
    assert not names[0] & names[1] and len(names[1]) >= 4
    for specs, expected in zip((tuning, scored), names, strict=True):
        assert {s.names[0] for s in specs if s.category == "out_of_catalogue"} == expected


def test_metadata_of_a_case_does_not_predict_whether_it_is_null():
    """Nearest neighbours on all visible metadata, trained and tested on half of the cases each."""
    specs = [s for s in CasePlan(4000, 4, "scored").specs() if s.training == 1]
    metadata = np.array(
        [[int(s.name, 16), case_plan.SPARSE_ROBOTS.index(s.robot), s.trusted] for s in specs], float
    )
    metadata = (metadata - metadata.mean(axis=0)) / metadata.std(axis=0)
    null, half = np.array([s.category == "null" for s in specs]), len(specs) // 2
    distance = np.square(metadata[half:, None] - metadata[None, :half]).sum(axis=2)
    votes, tried = null[np.argsort(distance, axis=1)[:, :25]].mean(axis=1), null[half:]
    # area under the curve: probability that a null case gets more votes than another
    more = votes[tried][:, None] > votes[~tried]
    area = (more + 0.5 * (votes[tried][:, None] == votes[~tried])).mean()
    assert 0.44 < area < 0.56


# -- four small cases, generated once ---------------------------------------------------------


def case_spec(
    number: int,
    name: str,
    category: str,
    names: tuple[str, ...] = (),
    trusted: bool = False,
    nuisance: str = "none",
    training: int = 1,
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
        training,
    )


SPECS = (
    case_spec(0, "0a0a0a", "null", nuisance="coarse_encoder"),
    case_spec(1, "0b0b0b", "single", ("load_friction",)),
    case_spec(2, "0c0c0c", "single", ("payload",), trusted=True),
    case_spec(3, "0d0d0d", "dense", ("position_friction",), training=2),
)


class FixedPlan(CasePlan):
    def specs(self) -> list[CaseSpec]:
        return list(SPECS)


DUMMY = """
import json, sys
from pathlib import Path
out, robot, *train = sys.argv[1:]
seen = sorted(str(p.relative_to(Path(robot).parents[1])) for p in Path(robot).parent.rglob("*"))
document = dict(findings=[], unknown=[], joints={}, seen=seen, train=len(train))
Path(out, "diagnosis.json").write_text(json.dumps(document))
Path(out, "model.json").write_text("{}")
"""
"""Analyst that asserts nothing and writes an empty model."""
PREDICTOR = f"""
import sys
from pathlib import Path
import numpy as np
sys.path.insert(0, {str(SCRIPT.parent)!r})
from concealed_trial.base_model_fit import read_table
from concealed_trial.run_analyst import in_band
model, recording, csv = map(Path, sys.argv[1:])
assert model.read_text() == "{{}}"
table = read_table(recording)
rate = 1.0 / np.median(np.diff(table["t"]))
out = {{k: in_band(x, rate) + 0.5 for k, x in table.items() if k.startswith("tau.")}}
rows = np.column_stack([table["t"], *out.values()])
np.savetxt(csv, rows, delimiter=",", header=",".join(["t", *out]), comments="")
"""
"""Predictor that is wrong by 0.5 N m."""


@pytest.fixture(scope="module")
def dummy(tmp_path_factory: pytest.TempPathFactory) -> Analyst:
    path = tmp_path_factory.mktemp("analyst") / "dummy.py"
    path.write_text(DUMMY)
    path.with_name("predictor.py").write_text(PREDICTOR)
    return Analyst("dummy", f"{sys.executable} {path} {{out}} {{robot}} {{train}}")


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory, dummy: Analyst) -> run.TrialFolder:
    trial = run.TrialFolder(tmp_path_factory.mktemp("trial"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(generate_cases, "PERIODS", {1: (2, 1), 2: (1, 1)})
        run.conceal(trial, FixedPlan(4, 0, "tuning"), 1, lambda _: None)
        predictor = Path(dummy.command.split()[1]).with_name("predictor.py")
        command = f"{{python}} {predictor} {{model}} {{recording}} {{csv}}"
        patch.setattr(run_analyst, "PREDICT_COMMAND", command)
        run.answer(trial, [dummy], 1, lambda _: None)
    return trial


@pytest.fixture(scope="module")
def key(trial: run.TrialFolder) -> dict[str, dict[str, object]]:
    return commitment.open_ground_truth(trial.key, trial.published_hash())


@pytest.mark.slow
def test_files_of_all_cases_look_the_same(trial):
    def looks(name: str) -> list[tuple[str, int, float]]:
        files = (p for p in (trial.cases / name).iterdir() if p.suffix != ".urdf")
        return sorted((p.name, p.stat().st_size, p.stat().st_mtime) for p in files)

    first, second, third, dense = (looks(s.name) for s in SPECS)
    assert first == second == [entry for entry in third if entry[0] != "prior.json"]
    recordings = ("train1", "train2", "validate")
    assert [e[0] for e in dense] == [f"{r}.{kind}" for r in recordings for kind in ("csv", "json")]


@pytest.mark.slow
def test_cases_are_reproducible_byte_for_byte(trial):
    again = generate_cases.analyst_files(generate_cases.generate_case(SPECS[1], run.MODELS))
    for name, text in again.items():
        assert (trial.cases / SPECS[1].name / name).read_text(encoding="utf-8") == text


@pytest.mark.slow
def test_dense_case_has_frictions_a_special_effect_and_an_oracle(key):
    truth = key["0d0d0d"]
    names = Counter(effect["effect"] for effect in truth["effects"])
    assert names["stribeck"] == names["nonlinear_viscous"] == names["hysteresis"] == 2
    assert names["delay"] == names["position_friction"] == 1
    special = truth["effects"][-1]
    assert special["effect"] == "position_friction" and special["unique_severity"] > 3.0
    for effect in truth["effects"]:
        assert 0.0 <= effect["unique_severity"] <= 1.1 * effect["severity"]
        assert effect["unique_severity"] == max(effect["unique_severity_by_joint"])
    held_out = truth["held_out"]
    assert min(np.divide(held_out["before"], held_out["oracle"])) > 2.0
    null = key["0a0a0a"]["held_out"]
    assert null["before"] == null["oracle"]


def test_torque_that_other_frictions_can_stand_for_is_not_unique():
    case = generate_cases.generate_case(SPECS[0], run.MODELS)
    robot, session = case.robot, case.sessions[0]
    motion, hertz = unique.sampled_motion(session.motion, robot, case.motions[0].periodic)
    projection = unique.TorqueProjection(robot, [motion], hertz, ())
    torque = np.zeros_like(motion.q)
    torque[:, 0] = unique.friction_columns(robot, 0, motion, ())["load"][:, 0]
    noise = np.ones(2)
    foreign, same = (
        projection.severity(name, "joint_1", [torque], noise)
        for name in ("position_friction", "load_friction")
    )
    assert foreign.unique[0] < 0.01 * foreign.alone[0]
    assert 0.1 * same.alone[0] < same.unique[0] <= same.alone[0] == foreign.alone[0]
    # a negative load friction stands for nothing, unless as much of a positive one is there
    negative = projection.severity("position_friction", "joint_1", [-torque], noise)
    assert negative.unique[0] > 0.1 * negative.alone[0]
    reduced = projection.severity("position_friction", "joint_1", [-torque], noise, [2.0 * torque])
    assert reduced.unique[0] < 0.01 * reduced.alone[0]


@pytest.mark.slow
def test_an_invisible_effect_is_drawn_without_the_nuisance(monkeypatch):
    """A slow robot has no observable drag."""
    monkeypatch.setattr(generate_cases, "MAX_EFFECT_DRAWS", 1)
    spec = case_spec(3, "0d0d0d", "single", ("drag",), nuisance="poor_excitation")
    case = generate_cases.generate_case(spec, run.MODELS)
    least = generate_cases.LEAST_SEVERITY
    assert case.spec.nuisance == "none" and case.hidden[0].severity.alone.max() > least
    slow = generate_cases.draw_case(spec, run.MODELS, 0.0)
    assert slow.hidden[0].severity.alone.max() < least


@pytest.mark.slow
def test_changed_session_changes_friction_of_the_validation_recording_only():
    plain, later = (
        generate_cases.generate_case(case_spec(4, "0e0e0e", "null", nuisance=nuisance), run.MODELS)
        for nuisance in ("none", "changed_session")
    )
    assert plain.sessions[0].recording.to_csv() == later.sessions[0].recording.to_csv()
    before, after = (case.sessions[1].robot.actuators for case in (plain, later))
    for kind in ("coulomb", "viscous"):
        change = getattr(after, kind) / getattr(before, kind) - 1.0
        assert np.all((np.abs(change) > 0.05) & (np.abs(change) < 0.4))
        assert len(set(np.sign(change))) == 1
    assert np.array_equal(before.inertia, after.inertia)
    assert np.array_equal(before.offset, after.offset)


def test_contact_happens_in_the_first_recording_only():
    case = generate_cases.generate_case(case_spec(5, "0f0f0f", "single", ("contact",)), run.MODELS)
    assert len(case.effects_of_session(0)) == 1 and not case.effects_of_session(1)


def test_rounded_angles_have_four_decimals():
    text = generate_cases.with_rounded_angles('<origin xyz="0.123456 0 0" rpy="0 -1.570796 0.1"/>')
    assert text == '<origin xyz="0.123456 0 0" rpy="0.0000 -1.5708 0.1000"/>'


# -- answers ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_ground_truth_is_committed_and_a_change_voids_the_trial(trial, tmp_path, key):
    published = trial.published_hash()
    assert commitment.digest(trial.key / "key.json") == published and len(published) == 64
    assert key["0b0b0b"]["effects"][0]["effect"] == "load_friction"
    text = (trial.key / "key.json").read_text()
    (tmp_path / "key.json").write_text(text.replace("load_friction", "drag"))
    with pytest.raises(UnusableInput, match="void"):
        commitment.open_ground_truth(tmp_path, published)


@pytest.mark.slow
def test_interrupted_trial_resumes(trial, tmp_path, dummy):
    copy = run.TrialFolder(tmp_path / "copy")
    shutil.copytree(trial.root, copy.root)
    (copy.answers / "dummy" / "0b0b0b.json").unlink()
    progress: list[str] = []
    run.conceal(copy, FixedPlan(4, 0, "tuning"), 1, progress.append)
    run.answer(copy, [dummy], 1, progress.append)
    assert len(progress) == 1 and progress[0].startswith("answered 2 of 4")
    assert copy.commitment.read_text() == trial.commitment.read_text()


def test_answer_before_the_commitment_is_refused(tmp_path, dummy):
    with pytest.raises(UnusableInput, match="not committed"):
        run.answer(run.TrialFolder(tmp_path), [dummy], 1, lambda _: None)


@pytest.mark.slow
def test_analyst_sees_a_copy_of_the_case_and_nothing_else(trial):
    entry = json.loads((trial.answers / "dummy" / "0c0c0c.json").read_text())
    names = ("prior.json", "robot.urdf", "train.csv", "train.json", "validate.csv", "validate.json")
    assert entry["answer"]["seen"] == [f"case/{name}" for name in names]
    assert entry["seconds"] > 0.0


@pytest.mark.slow
def test_model_of_the_analyst_is_kept_and_read_again(trial):
    entry = json.loads((trial.answers / "dummy" / "0d0d0d.json").read_text())
    assert entry["answer"]["train"] == 2
    assert (trial.answers / "dummy" / "models" / "0d0d0d.json").read_text() == "{}"
    assert entry["predicted"] == pytest.approx({"joint_1": 0.5, "joint_2": 0.5}, rel=1e-2)


@pytest.mark.slow
def test_failing_analyst_counts_as_no_answer(trial, tmp_path, key):
    broken = Analyst("broken", f"{sys.executable} -c 'raise SystemExit(3)'")
    run_analyst.ask(broken, trial.cases / "0a0a0a", tmp_path)
    entry = json.loads((tmp_path / "broken" / "0a0a0a.json").read_text())
    comparison = compare_answer(key["0a0a0a"], entry)
    assert not comparison.answered and score([comparison])["null_asserted"]["value"] == 1.0


@pytest.mark.slow
def test_report_has_the_table_and_the_blind_analyst(trial):
    text = run.report(trial)
    assert "| | asked | dummy | blind |" in text and "≥ 0.95" in text
    scores = json.loads((trial.root / "score.json").read_text())["scores"]
    assert scores["dummy"]["null_asserted"]["value"] == 0.0
    assert scores["blind"]["null_asserted"]["value"] == 1.0
    assert scores["blind"]["dense_recall_3"]["value"] < 1.0  # it does not name the special effect
    assert "ground truth committed: " in (trial.root / "log.txt").read_text()


# -- scores of hand-made answers --------------------------------------------------------------


def hidden(effect: str, joint: str | None = "a", unique: float = 5.0, **more: object):
    return {
        "effect": effect,
        "joint": joint,
        "outsider": False,
        "severity": unique,
        "unique_severity": unique,
        "details": {},
        "parameters": {},
        **more,
    }


def case_with(category: str, *effects: dict[str, object], names: tuple[str, ...] = ()):
    return {
        "spec": {"category": category, "names": names},
        "joints": ["a", "b"],
        "effects": list(effects),
        "held_out": {"before": [3.0, 3.0], "oracle": [1.0, 1.0], "noise": [1.0, 1.0]},
    }


def finding(effect: str, joint: str | None = "a", probability: float = 0.9, **more: object):
    return {
        "effect": effect,
        "joint": joint,
        "probability": probability,
        "equivalents": [],
        "parameters": {},
        **more,
    }


def mark(case, *findings, unknown=(), after: float = 2.0, considered=(), predicted=None) -> Mark:
    answer = {
        "findings": list(findings),
        "unknown": list(unknown),
        "considered": list(considered),
        "joints": {name: {"rmse_after": after} for name in case["joints"]},
    }
    return compare_answer(case, {"seconds": 1.0, "answer": answer, "predicted": predicted})


DENSE = case_with(
    "dense",
    hidden("stribeck"),
    hidden("hysteresis", "b", 2.0),
    hidden("load_friction", "b", 0.2),
    hidden("delay", None, 1.5),
    hidden("spring", "b", 3.5),
    names=("spring",),
)


def test_perfect_answer_reaches_everything():
    findings = [finding(e["effect"], e["joint"], 1.0) for e in DENSE["effects"]]
    figures = score([mark(DENSE, *findings, after=1.0, predicted={"a": 1.0, "b": 1.005})])
    for name in ("dense_recall_1", "dense_recall_3", "dense_precision", "special"):
        assert figures[name]["value"] == 1.0, name
    assert figures["dense_recall_1"]["count"] == 4 and figures["dense_recall_3"]["count"] == 2
    assert figures["gain_median"]["value"] == figures["oracle_ratio"]["value"] == 1.0
    assert figures["model_ratio"]["value"] == pytest.approx(1.005)
    assert figures["probability"]["log_loss"] < 0.01


def test_blind_answer_has_its_known_precision_and_recall():
    figures = score([compare_answer(DENSE, blind_answer(DENSE))])
    # of five effects at two joints: one of a, two of b, and the delay of both
    assert figures["dense_precision"]["count"] == 2 * len(BLIND_EFFECTS)
    assert figures["dense_precision"]["value"] == pytest.approx(0.5)
    assert figures["dense_recall_1"]["value"] == 0.75 and figures["special"]["value"] == 0.0


def test_right_effect_in_the_wrong_joint_is_wrong():
    figures = score([mark(DENSE, finding("stribeck", "b"))])
    assert figures["dense_precision"]["value"] == figures["dense_recall_1"]["value"] == 0.0


def test_equivalents_make_a_finding_right_but_name_one_effect_only():
    equivalent = finding("torque_ripple", "b", equivalents=["hysteresis", "spring"])
    figures = score([mark(DENSE, equivalent)])
    assert figures["dense_precision"]["value"] == 1.0 and figures["equivalents"]["value"] == 2.0
    assert figures["dense_recall_1"]["value"] == 0.25
    sparse = case_with("single", hidden("delay"))
    first = mark(sparse, finding("hysteresis", equivalents=["delay"]))
    figures = score([first])
    assert figures["sparse_first_from 3"]["value"] == 0.0
    assert figures["sparse_precision"]["value"] == 1.0
    assert are_equivalent("drag", "nonlinear_viscous") and not are_equivalent("drag", "delay")


def test_nulls_and_unknowns():
    null = case_with("null")
    unknown = {"joint": "a", "where": {"regime": "power"}}
    session = {"joint": "a", "where": {"regime": "recording"}}
    marks = [mark(null), mark(null, unknown=(session,)), mark(null, unknown=(unknown,))]
    assert [score([m])["null_asserted"]["value"] for m in marks] == [0.0, 0.0, 1.0]
    odd = case_with("out_of_catalogue", hidden("sloshing", outsider=True))
    marks = [mark(odd, unknown=(unknown,)), mark(odd, finding("drag"), unknown=(unknown,))]
    assert [score([m])["unknown_not_named"]["value"] for m in marks] == [1.0, 0.0]
    assert score(marks)["unknown_reported"]["value"] == 1.0


def test_held_out_gain_and_ratios():
    figures = score([mark(DENSE, after=2.0)])
    assert figures["gain_median"]["value"] == pytest.approx((9.0 - 4.0) / (9.0 - 1.0))
    assert figures["oracle_ratio"]["value"] == pytest.approx(2.0)
    assert figures["model_ratio"]["value"] == np.inf  # no model could be read again


def test_severity_interval_and_parameters_of_right_findings():
    parameters = {"amplitude": {"value": 2.0, "unit": "N m"}}
    case = case_with("single", hidden("stribeck", parameters=parameters))
    stated = {"amplitude": {"value": 2.2, "std": 0.2, "unit": "N m"}}
    good = finding("stribeck", evidence={"severity_interval": [4.0, 6.0]}, parameters=stated)
    bad = finding("stribeck", evidence={"severity_interval": [5.5, 6.0]})
    assert mark(case, good).coverage == (True,) and mark(case, bad).coverage == (False,)
    assert mark(case, good).errors == (("stribeck.amplitude", pytest.approx(0.1), True),)


def test_probabilities_of_findings_and_considered_effects():
    right, wrong = finding("stribeck", probability=0.9), finding("drag", probability=0.2)
    assert mark(DENSE, right, considered=(wrong,)).probabilities == ((0.9, True), (0.2, False))
    figures = probability_score([(0.8, True)] * 80 + [(0.8, False)] * 20)
    assert figures["log_loss"] == pytest.approx(figures["base_rate_log_loss"])
    assert figures["error"] == pytest.approx(0.0)
    assert probability_score([(0.8, True)])["error"] is None  # too few for a bin


@pytest.mark.parametrize(
    "broken",
    [None, [], {}, {"error": "x"}, {"findings": [{"effect": 1}], "unknown": [], "joints": {}}],
)
def test_malformed_diagnosis_counts_as_no_answer(broken):
    assert not compare_answer(case_with("null"), {"seconds": 0.0, "answer": broken}).answered


def test_rates_have_wilson_intervals():
    figures = rate([True])
    assert figures["value"] == 1.0 and figures["interval"] == pytest.approx([0.2065, 1.0], abs=1e-3)
    assert rate([]) == {"value": None, "count": 0}
    assert table.table({"x": score([])}).count("–") > 20


# -- the script -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "--analyst", "blind=x"), "must read NAME=COMMAND"),
        (("conceal", "--groups", "dense,thin"), "no group 'thin'"),
    ],
)
def test_wrong_use_prints_one_line(tmp_path, arguments, words):
    done = subprocess.run(
        [sys.executable, str(SCRIPT), *arguments, "-o", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1 and words in done.stderr

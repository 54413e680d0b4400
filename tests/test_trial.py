"""The trial: what is hidden stays hidden until the key is opened, and then it is counted right."""

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
from concealed_trial.case_plan import Plan, Spec
from concealed_trial.run_analyst import Analyst
from concealed_trial.score import Mark, calibration, equal, mark, score

from excite.errors import UnusableInput

SCRIPT = Path(__file__).parents[1] / "scripts" / "concealed_trial"


# -- the plan ------------------------------------------------------------------------------------------------------


def test_300_cases_hold_60_nulls_with_every_trap_and_every_name():
    specs = Plan(300, 1, "scored").specs()
    nulls = [s for s in specs if s.sort == "null"]
    assert len(specs) == 300 and len(nulls) >= 60
    assert {s.trap for s in nulls} == set(case_plan.TRAPS)
    singles = [s.names[0] for s in specs if s.sort == "single"]
    assert set(singles) == set(case_plan.REFIT + case_plan.PRIOR_ONLY)
    assert {s.severities[0] for s in specs if s.severities} == {1.0, 3.0, 10.0, 30.0}
    assert {s.sort for s in specs} == {"null", "single", "pair", "outsider"}
    assert len({s.name for s in specs}) == 300 and all(len(s.name) == 6 for s in specs)
    # a prior tells nothing of whether something is hidden
    share = [
        np.mean([s.trusted for s in specs if (s.sort == "null") == null]) for null in (True, False)
    ]
    assert share[0] == pytest.approx(share[1], abs=0.02)


def test_tuning_and_scored_cases_share_no_seed_and_no_name():
    tuning, scored = Plan(300, 1, "tuning").specs(), Plan(300, 1, "scored").specs()
    assert not {s.seed for s in tuning} & {s.seed for s in scored}
    assert len({s.name for s in tuning} & {s.name for s in scored}) <= 1
    assert {s.family for s in tuning} == {"tuning"} and {s.family for s in scored} == {"scored"}


def test_a_classifier_that_sees_metadata_alone_stays_at_chance():
    """Nearest neighbours on all that a listing shows of a case, taught on 1000 cases, tried on 1000 more."""
    specs = Plan(2000, 4, "scored").specs()
    seen = np.array(
        [
            [s.number % 1000, int(s.name, 16), case_plan.ROBOTS.index(s.robot), s.trusted]
            for s in specs
        ],
        float,
    )
    seen = (seen - seen.mean(axis=0)) / seen.std(axis=0)
    null = np.array([s.sort == "null" for s in specs])
    distance = np.square(seen[1000:, None] - seen[None, :1000]).sum(axis=2)
    votes = null[np.argsort(distance, axis=1)[:, :25]].mean(axis=1)
    tried = null[1000:]
    # area under the curve: the chance that a null gets more votes than a case that hides something
    area = (votes[tried][:, None] > votes[~tried]).mean() + 0.5 * (
        votes[tried][:, None] == votes[~tried]
    ).mean()
    assert 0.44 < area < 0.56


# -- three small cases, made once ----------------------------------------------------------------------------------


def spec(
    number: int,
    name: str,
    sort: str,
    names: tuple[str, ...] = (),
    trusted: bool = False,
    trap: str = "none",
) -> Spec:
    return Spec(
        number,
        name,
        "two_link",
        sort,
        trusted,
        names,
        (10.0,) * len(names),
        trap,
        "tuning",
        100 + number,
    )


SPECS = (
    spec(0, "0a0a0a", "null", trap="coarse_encoder"),
    spec(1, "0b0b0b", "single", ("load_friction",)),
    spec(2, "0c0c0c", "single", ("payload",), trusted=True),
)


class Fixed(Plan):
    def specs(self) -> list[Spec]:
        return list(SPECS)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> run.Place:
    place = run.Place(tmp_path_factory.mktemp("trial"))
    run.conceal(place, Fixed(3, 0, "tuning"), 1, lambda _: None)
    run.answer(place, [run_analyst.baseline_analysts()], 1, lambda _: None)
    return place


def test_files_of_all_cases_look_the_same(place):
    def looks(name: str) -> list[tuple[str, int, float]]:
        return sorted(
            (p.name, p.stat().st_size, p.stat().st_mtime)
            for p in (place.cases / name).iterdir()
            if p.suffix != ".urdf"
        )

    first, second, third = (looks(s.name) for s in SPECS)
    assert first == second == [entry for entry in third if entry[0] != "prior.json"]
    sidecars = {
        (place.cases / s.name / f"{which}.json").read_text()
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
        for p in (place.cases / s.name).iterdir()
    )


def test_the_same_case_is_the_same_to_the_last_byte(place):
    again = generate_cases.given(generate_cases.bench(SPECS[1], run.MODELS))
    assert all(
        (place.cases / SPECS[1].name / name).read_text(encoding="utf-8") == text
        for name, text in again.items()
    )


def test_what_a_trap_hides_altogether_is_made_without_it():
    """A robot that crawls has no drag: there is no truth to be found."""
    case = generate_cases.bench(
        spec(3, "0d0d0d", "single", ("drag",), trap="poor_excitation"), run.MODELS
    )
    assert case.spec.trap == "none" and case.hidden[0][1] > generate_cases.SHOWS
    assert (
        generate_cases._drawn(
            spec(3, "0d0d0d", "single", ("drag",), trap="poor_excitation"), run.MODELS, 0.0
        ).hidden[0][1]
        < generate_cases.SHOWS
    )


def test_on_another_day_friction_is_another_and_nothing_else():
    plain, later = (
        generate_cases.bench(spec(4, "0e0e0e", "null", trap=trap), run.MODELS)
        for trap in ("none", "another_day")
    )
    assert plain.sessions[0].recording.csv() == later.sessions[0].recording.csv()
    one, other = (case.sessions[1].plant.drive for case in (plain, later))
    for kind in ("coulomb", "viscous"):
        factor = getattr(other, kind) / getattr(one, kind)
        assert (
            np.all((np.abs(factor - 1.0) > 0.05) & (np.abs(factor - 1.0) < 0.4))
            and len(set(np.sign(factor - 1.0))) == 1
        )
    assert np.array_equal(one.inertia, other.inertia) and np.array_equal(one.offset, other.offset)


def test_friction_of_another_day_is_no_unknown_physics():
    def told(regime: str) -> Mark:
        answer = {
            "findings": [],
            "unknown": [{"joint": "joint_1", "where": {"regime": regime}}],
            "joints": {},
        }
        case = {
            "spec": {"sort": "null", "trap": "another_day", "trusted": False},
            "effects": [],
            "joints": [],
        }
        return mark(case, {"answer": answer, "seconds": 1.0})

    assert told("recording").silent and not told("power").silent


def test_the_key_is_sealed_and_a_changed_one_voids_the_trial(place, tmp_path):
    sealed = place.sealed.read_text().strip()
    assert commitment.digest(place.key / "key.json") == sealed and len(sealed) == 64
    cases = commitment.unlock(place.key, sealed)
    assert cases["0b0b0b"]["effects"][0]["effect"] == "load_friction"
    (tmp_path / "key.json").write_text(
        (place.key / "key.json").read_text().replace("load_friction", "drag")
    )
    with pytest.raises(UnusableInput, match="void"):
        commitment.unlock(tmp_path, sealed)


def test_an_interrupted_trial_goes_on_where_it_was(place, tmp_path):
    import shutil

    copy = run.Place(tmp_path / "copy")
    shutil.copytree(place.root, copy.root)
    (copy.answers / "greedy" / "0b0b0b.json").unlink()
    said: list[str] = []
    run.conceal(copy, Fixed(3, 0, "tuning"), 1, said.append)
    run.answer(copy, [run_analyst.baseline_analysts()], 1, said.append)
    assert len(said) == 1 and said[0].startswith("answered 2 of 3")
    assert copy.sealed.read_text() == place.sealed.read_text()


def test_an_answer_before_the_seal_is_refused(tmp_path):
    with pytest.raises(UnusableInput, match="not sealed"):
        run.answer(run.Place(tmp_path), [run_analyst.baseline_analysts()], 1, lambda _: None)


def test_an_analyst_sees_a_copy_of_the_case_and_nothing_else(place, tmp_path):
    code = (
        "import sys, json, os; from pathlib import Path; folder = Path(sys.argv[1]);"
        "names = sorted(str(p.relative_to(folder.parent)) for p in folder.parent.rglob('*'));"
        "document = dict(findings=[], unknown=[], joints={}, seen=names, cwd=os.getcwd());"
        "Path(sys.argv[2], 'diagnosis.json').write_text(json.dumps(document))"
    )
    (tmp_path / "spy.py").write_text(code)
    spy = Analyst(("spy",), f"{sys.executable} {tmp_path / 'spy.py'} {{case}} {{out}}")
    assert run_analyst.ask(spy, place.cases / "0c0c0c", tmp_path / "answers") is not None
    seen = json.loads((tmp_path / "answers" / "spy" / "0c0c0c.json").read_text())["answer"]
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
    assert seen["seen"] == ["case", *files, "out"] and "0c0c0c" not in seen["cwd"]


def test_an_analyst_that_fails_has_given_no_answer(place, tmp_path):
    broken = Analyst(("broken",), f"{sys.executable} -c 'raise SystemExit(3)'")
    run_analyst.ask(broken, place.cases / "0a0a0a", tmp_path)
    entry = json.loads((tmp_path / "broken" / "0a0a0a.json").read_text())
    found = mark(commitment.unlock(place.key, place.sealed.read_text().strip())["0a0a0a"], entry)
    assert (
        not found.answered and not found.silent and score([found])["false_alarms"]["value"] == 1.0
    )


def test_baselines_answer_in_the_contracts_words_and_the_greedy_one_knows_a_plain_case(place):
    for name in run_analyst.BASELINES:
        document = json.loads((place.answers / name / "0b0b0b.json").read_text())["answer"]
        assert document["schema"] == "excite.diagnosis/1"
        assert set(document["joints"]) == {"joint_1", "joint_2"}
    greedy = json.loads((place.answers / "greedy" / "0b0b0b.json").read_text())["answer"]
    assert "load_friction" in {f["effect"] for f in greedy["findings"]}
    assert json.loads((place.answers / "greedy" / "0c0c0c.json").read_text())["answer"]["findings"]
    stribeck = json.loads((place.answers / "stribeck" / "0a0a0a.json").read_text())["answer"]
    assert [f["effect"] for f in stribeck["findings"]] == ["stribeck"]


def test_the_oracle_knows_more_than_the_base_model(place):
    cases = commitment.unlock(place.key, place.sealed.read_text().strip())
    held = cases["0b0b0b"]["held_out"]
    assert max(held["before"]) > 2.0 * max(held["oracle"])
    null = cases["0a0a0a"]["held_out"]
    assert null["before"] == null["oracle"]


def test_the_report_has_its_tables_and_pictures(place):
    text = run.report(place)
    assert "false alarms on nulls" in text and "greedy" in text
    document = json.loads((place.root / "score.json").read_text())
    alarms = document["scores"]["stribeck"]["false_alarms"]
    assert (alarms["value"], alarms["count"]) == (1.0, 1) and alarms["interval"][
        0
    ] == pytest.approx(0.2065, abs=1e-3)
    assert document["confusion"]["stribeck"]["load_friction"] == {"stribeck": 1}
    for name in ("confusion.svg", "reliability.svg"):
        assert "<svg" in (place.root / name).read_text()
    assert "sealed: " in (place.root / "log.txt").read_text()


# -- marks ---------------------------------------------------------------------------------------------------------


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


def key_of(sort: str, *effects: dict[str, object]) -> dict[str, object]:
    return {
        "spec": {"sort": sort, "trap": "none", "trusted": False},
        "joints": ["a"],
        "effects": [
            {"outsider": False, "severity": 5.0, "details": {}, "parameters": {}, **e}
            for e in effects
        ],
        "held_out": {"before": [3.0], "oracle": [1.0], "noise": [1.0]},
    }


def said(
    *findings: dict[str, object], unknown: tuple[object, ...] = (), after: float = 2.0
) -> dict[str, object]:
    answer = {
        "findings": list(findings),
        "unknown": list(unknown),
        "joints": {"a": {"rmse_after": after}},
    }
    return {"seconds": 1.0, "answer": answer}


def test_a_mark_counts_name_joint_parameters_and_gain():
    key = key_of(
        "single",
        {"effect": "drag", "joint": "a", "parameters": {"coefficient": {"value": 2.0, "unit": ""}}},
    )
    found = mark(
        key,
        said(
            finding("drag", "a", parameters={"coefficient": {"value": 2.2, "std": 0.2, "unit": ""}})
        ),
    )
    assert found.first == "drag" and found.joint
    assert found.errors == (("drag.coefficient", pytest.approx(0.1), True),)
    assert found.gain == pytest.approx((9.0 - 4.0) / (9.0 - 1.0))
    assert not mark(key, said(finding("drag", "b"))).joint
    assert (
        score([mark(key, said(finding("nonlinear_viscous", "a")))])["right_first"]["value"] == 1.0
    )


def test_silence_is_right_on_nulls_only():
    null, single = key_of("null"), key_of("single", {"effect": "drag", "joint": "a"})
    assert score([mark(null, said())])["false_alarms"]["value"] == 0.0
    assert score([mark(null, said(unknown=({"joint": "a"},)))])["false_alarms"]["value"] == 1.0
    assert score([mark(single, said())])["abstained"]["value"] == 1.0
    assert score([mark(single, said(unknown=({"joint": "a"},)))])["abstained"]["value"] == 0.0


def test_equivalents_pairs_outsiders_and_contacts():
    within = mark(
        key_of("single", {"effect": "delay", "joint": "a"}),
        said({**finding("hysteresis", "a"), "equivalents": ["delay"]}),
    )
    figures = score([within])
    assert (
        figures["right_first"]["value"],
        figures["within_equivalents"]["value"],
        figures["equivalents"]["value"],
    ) == (0.0, 1.0, 1.0)
    both = key_of("pair", {"effect": "delay", "joint": "a"}, {"effect": "stribeck", "joint": "a"})
    assert (
        score([mark(both, said(finding("stribeck", "a"), finding("delay", "a", 0.6)))])[
            "both_of_two"
        ]["value"]
        == 1.0
    )
    assert score([mark(both, said(finding("stribeck", "a")))])["both_of_two"]["value"] == 0.0
    odd = key_of("outsider", {"effect": "sloshing", "joint": "a", "outsider": True})
    assert (
        score([mark(odd, said(unknown=({"joint": "a"},)))])["unknown_where_it_is"]["value"] == 1.0
    )
    details = {"start": {"value": 2.0}, "end": {"value": 4.0}}
    touch = key_of("single", {"effect": "contact", "joint": "a", "details": details})
    assert mark(
        touch, said(finding("contact", "a", where={"time": [3.0, 5.0]}))
    ).overlap == pytest.approx(1.0 / 3.0)


@pytest.mark.parametrize(
    "broken",
    [None, [], {}, {"error": "x"}, {"findings": [{"effect": 1}], "unknown": [], "joints": {}}],
)
def test_what_is_no_diagnosis_is_no_answer(broken):
    assert not mark(key_of("null"), {"seconds": 0.0, "answer": broken}).answered


def test_calibration_is_0_for_who_says_what_he_knows():
    plain = mark(
        key_of("single", {"effect": "drag", "joint": "a"}), said(finding("drag", "a", 1.0))
    )
    wrong: Mark = replace(plain, truth=("delay",))
    assert calibration([plain])["error"] == 0.0
    assert calibration([plain, wrong])["error"] == pytest.approx(0.5)


def test_names_that_the_contract_calls_the_same():
    assert equal("drag", "nonlinear_viscous") and not equal("drag", "delay")


# -- the script ----------------------------------------------------------------------------------------------------


def test_wrong_use_is_one_line(tmp_path):
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "run", "--analyst", "greedy=x", "-o", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (
        done.returncode == 2
        and len(done.stderr.strip().splitlines()) == 1
        and "name of its own" in done.stderr
    )

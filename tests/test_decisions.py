"""Decisions between rivals: diagnosis, discriminating motion, diagnosis of both recordings."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import diagnosis_cases as cases
import numpy as np
import pytest
from synthetic_recordings import synthetic_recording, write_recording

from excite import api
from excite.api.design_result import CellOptions
from excite.cli.main import main
from excite.designer.discrimination import EVIDENCE_SHARE, SeparationObjective, WeightedRows
from excite.designer.discrimination_design import sampled_motion
from excite.diagnosis import probability
from excite.diagnosis.decisions import Decision, Decisions, ExpectedEvidence
from excite.report.decisions import decision_rows, decisions_answer
from excite.report.formatting import odds_words
from excite.trajectory import trajectory_file
from excite.trajectory.fourier import FourierSeries

TRUTH, RIVAL = "position_friction", "load_friction"
"""The effect that acts at the first joint, and what a single slow wave cannot tell from it."""
NOISE = 0.1
"""Standard deviation of the torque noise [N m]."""


def record(fourier: FourierSeries, seed: int, path: Path, periods: int = 4) -> Path:
    """Write a recording of the two-link robot with friction that depends on position."""
    exact = synthetic_recording(cases.SUBJECT, cases.PSI, fourier, periods, 0.0, cases.RATE)
    s = fourier.samples(exact.t)
    effect = cases.HIDDEN[TRUTH].torque(exact.t, s.q, s.dq, exact.torque)
    noise = NOISE * np.random.default_rng(seed).normal(size=exact.torque.shape)
    return write_recording(dataclasses.replace(exact, tau=exact.torque + effect + noise), path)


def single_wave(seed: int) -> FourierSeries:
    """Return a slow motion with one harmonic."""
    rng = np.random.default_rng(seed)
    sine, cosine = rng.normal(0.0, 0.35, (2, 2, 1))
    return FourierSeries(sine, cosine, rng.normal(0.0, 0.5, 2), 5.0)


@dataclasses.dataclass(frozen=True)
class Loop:
    """Files of one turn of the loop: record, diagnose, design, record."""

    folder: Path
    before: dict[str, Any]
    design: api.DesignResult

    def diagnose(self, *more: str) -> list[str]:
        """Return the arguments of the diagnosis of both recordings."""
        files = [str(self.folder / name) for name in ("1.csv", "held_out.csv", "2.csv")]
        first, held_out, second = files
        arguments = ["diagnose", "two_link", first, "--validate", held_out]
        return [*arguments, "--discriminating", second, "-o", str(self.folder / "after"), *more]


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Loop:
    folder = tmp_path_factory.mktemp("loop")
    first = record(single_wave(2), 2, folder / "1.csv")
    held_out = record(single_wave(5), 5, folder / "held_out.csv")
    before = api.diagnose("two_link", [first], [held_out], with_report=False)
    before.save(folder / "before")
    design = api.design(
        "two_link",
        cell=CellOptions(check=False),
        period=4.0,
        harmonics=3,
        starts=2,
        jobs=1,
        discriminate=folder / "before" / "diagnosis.json",
        given=[first],
    )
    design.save(folder / "next")
    record(design.trajectory.motion.fourier, 3, folder / "2.csv")
    return Loop(folder, before.document(), design)


def test_a_finding_states_the_rival_that_the_recording_does_not_exclude(loop: Loop):
    (finding,) = loop.before["findings"]
    odds = {rival["effect"]: rival["log_odds"] for rival in finding["rivals"]}
    assert {finding["effect"], *odds} >= {TRUTH, RIVAL}
    assert abs(odds[({TRUTH, RIVAL} - {finding["effect"]}).pop()]) < np.log(20.0)


def test_the_trajectory_states_the_expected_evidence(loop: Loop):
    trajectory = trajectory_file.read_trajectory(loop.folder / "next" / "trajectory.json")
    expected = ExpectedEvidence.of_design(trajectory.design)
    assert expected is not None and expected.with_given
    joint = cases.SUBJECT.robot.joints[0]
    assert expected.log_bayes_factors[joint, TRUTH, RIVAL] > 25.0
    assert trajectory.design["torque_noise_source"].startswith("from ")
    floors = [entry["noise_floor"] for entry in loop.before["joints"].values()]
    np.testing.assert_allclose(trajectory.noise, floors)


def test_both_recordings_decide_for_the_truth(loop: Loop, capsys: pytest.CaptureFixture[str]):
    before = str(loop.folder / "before" / "diagnosis.json")
    assert main(loop.diagnose("--before", before)) == 0
    text = capsys.readouterr().out
    assert "further recordings: 1 of 1 open pair decided: friction that depends on position" in text
    document = json.loads((loop.folder / "after" / "diagnosis.json").read_text(encoding="utf-8"))
    decision = next(d for d in document["decisions"] if {d["effect"], d["rival"]} == {TRUTH, RIVAL})
    assert decision["decided_for"] == TRUTH
    stated = {r["effect"]: r["log_odds"] for r in loop.before["findings"][0]["rivals"]}
    assert decision["log_odds"]["before"] == pytest.approx(stated[decision["rival"]])
    assert decision["log_odds"]["expected"] is None
    names = [f["effect"] for f in document["findings"] if f["joint"] == decision["joint"]]
    assert TRUTH in names and RIVAL not in names
    html = (loop.folder / "after" / "report.html").read_text(encoding="utf-8")
    assert "What did the further recording decide?" in html


@pytest.mark.slow
def test_the_odds_before_are_computed_and_those_expected_are_read(loop: Loop):
    trajectory = loop.folder / "next" / "trajectory.json"
    result = api.diagnose(
        "two_link",
        [loop.folder / "1.csv"],
        [loop.folder / "held_out.csv"],
        discriminating=[loop.folder / "2.csv"],
        trajectory=trajectory,
        with_report=False,
    )
    (decision,) = (
        d for d in result.document()["decisions"] if {d["effect"], d["rival"]} == {TRUTH, RIVAL}
    )
    odds = decision["log_odds"]
    assert odds["expected"]["effect"] > 5.0 and odds["expected"]["rival"] < -5.0
    assert abs(odds["after"]) > abs(odds["before"])


def test_given_recordings_add_to_every_separation(loop: Loop):
    problem = loop.design.delivery.design.setup.problem
    objective = problem.objective
    assert isinstance(objective, SeparationObjective) and objective.given is not None
    motion = sampled_motion(
        problem.robot, problem.parameters, loop.design.trajectory.motion.fourier
    )
    alone = dataclasses.replace(objective, given=None)
    assert (objective.separations(motion) > alone.separations(motion)).all()


def test_compressed_rows_have_the_same_inner_products():
    rng = np.random.default_rng(0)
    rows = WeightedRows(rng.normal(size=(50, 3)), rng.normal(size=(50, 4)))
    few = rows.compressed()
    assert len(few.base) == 7
    np.testing.assert_allclose(few.base.T @ few.columns, rows.base.T @ rows.columns, atol=1e-12)
    np.testing.assert_allclose(few.columns.T @ few.columns, rows.columns.T @ rows.columns)


def test_a_design_counts_evidence_as_a_diagnosis_does():
    assert pytest.approx(1.0 / probability.RARE_TEMPERATURE) == EVIDENCE_SHARE


def test_only_excluded_equivalents_leave_a_finding():
    evidence = {"stribeck": 0.0, "hysteresis": -100.0, "delay": -2.0}
    pair = Decision("elbow", "stribeck", "hysteresis", 0.5, None, 20.0)
    decisions = Decisions((pair,), (("elbow", evidence),))
    equivalents = ["hysteresis", "delay", "drag"]
    assert decisions.excluded("elbow", "stribeck", equivalents) == {"hysteresis"}
    assert not decisions.excluded("wrist", "stribeck", equivalents)
    assert pair.document()["decided_for"] == "stribeck"


def test_a_decision_for_what_is_not_found_says_so():
    pair = Decision("elbow", "stribeck", "drag", 0.5, None, 20.0).document()
    finding = {"effect": "hysteresis", "joint": "elbow", "equivalents": []}
    document = {"decisions": [pair], "findings": [finding]}
    assert decision_rows(document)[0][-1] == "Stribeck friction, not found"
    assert (
        "superfluous next to the findings: Stribeck friction at elbow"
        in decisions_answer(document)[0]
    )
    document["findings"] = [{**finding, "equivalents": ["stribeck"]}]
    assert decision_rows(document)[0][-1] == "Stribeck friction"
    assert decisions_answer(document)[0] == "1 of 1 open pair decided: Stribeck friction at elbow."


@pytest.mark.parametrize(
    ("after", "name"), [(20.0, "stribeck"), (-20.0, "hysteresis"), (1.0, None), (-1.0, None)]
)
def test_a_pair_is_decided_from_twenty_to_one(after: float, name: str | None):
    assert Decision(None, "stribeck", "hysteresis", None, None, after).decided_for == name


def test_expected_odds_begin_with_those_before_unless_given():
    factors = {("j", "a", "b"): 50.0, ("j", "b", "a"): 30.0}
    assert ExpectedEvidence(factors, False).log_odds(("j", "a", "b"), 1.0) == (11.0, -5.0)
    assert ExpectedEvidence(factors, True).log_odds(("j", "a", "b"), 1.0) == (10.0, -6.0)
    assert ExpectedEvidence(factors, True).log_odds(("j", "a", "c"), 1.0) is None


@pytest.mark.parametrize(
    ("log_odds", "words"),
    [(None, "–"), (0.0, "1 : 1"), (5.0, "150 : 1"), (-1.4, "1 : 4.1"), (9.0, "> 1000 : 1")],
)
def test_odds_in_words(log_odds: float | None, words: str):
    assert odds_words(log_odds) == words


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d["findings"][0].update(joint="elbow"), "no joint 'elbow'"),
        (lambda d: d.update(schema="excite.model/1"), "schema"),
    ],
)
def test_an_unusable_earlier_diagnosis_is_one_line(
    change: Any, words: str, loop: Loop, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    document = json.loads(json.dumps(loop.before))
    change(document)
    path = tmp_path / "before.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    assert main(loop.diagnose("--before", str(path))) == 2
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert words in last and str(path) in last


def test_an_earlier_diagnosis_needs_a_further_recording(
    loop: Loop, capsys: pytest.CaptureFixture[str]
):
    before = str(loop.folder / "before" / "diagnosis.json")
    arguments = loop.diagnose("--before", before)
    place = arguments.index("--discriminating")
    assert main([*arguments[:place], *arguments[place + 2 :]]) == 2
    assert "--discriminating" in capsys.readouterr().err

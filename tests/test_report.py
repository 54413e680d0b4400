"""Reports are self-contained, state failures, and answer the question of every section."""

from __future__ import annotations

import dataclasses
import re
import xml.etree.ElementTree as ElementTree
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from excite.collision import continuous_check, scene_file
from excite.designer import criteria, identifiability, ramps
from excite.designer.certificate import Certificate, LimitMargin, promised_share
from excite.designer.constraint_margins import MotionConstraints
from excite.designer.multistart import Attempt
from excite.designer.sqp import History, SearchState
from excite.report import design_page, identifiability_page
from excite.report.design import relative_margins
from excite.report.figures.drawing import thin_curve
from excite.report.figures.small_multiples import CurvePanel, draw_curves
from excite.report.figures.svg import round_ticks
from excite.report.formatting import number
from excite.robot import base_parameters, dynamics, inertial_parameters, limits, robot
from excite.trajectory import trajectory_file
from excite.trajectory.fourier import FourierSeries
from excite.trajectory.trajectory_file import Trajectory

SECTIONS = (
    "limits",
    "torque",
    "collision",
    "spectrum",
    "parts",
    "parameters",
    "more",
    "path",
    "history",
    "criteria",
    "made",
)


def chain(joints: int) -> str:
    """A URDF of links in a row, one of its joints sliding."""
    inertia = '<inertia ixx="0.01" iyy="0.011" izz="0.006" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><origin xyz="0.02 0.01 0.08"/><mass value="1.2"/>{inertia}</inertial>'
    text = '<robot name="chain"><link name="base"/>'
    parent = "base"
    for k in range(1, joints + 1):
        kind = "prismatic" if k == 3 else "revolute"
        axis = ("0 0 1", "0 1 0", "1 0 0")[k % 3]
        text += f'<link name="link_{k}">{inertial}</link><joint name="joint_{k}" type="{kind}">'
        text += f'<origin xyz="0 0 0.1"/><parent link="{parent}"/><child link="link_{k}"/>'
        text += f'<axis xyz="{axis}"/>'
        text += '<limit lower="-1.5" upper="1.5" velocity="3" effort="200"/></joint>'
        parent = f"link_{k}"
    return text + "</robot>"


@cache
def parts(source: str) -> tuple:
    loaded = robot.load(source)
    table = limits.resolve(loaded)
    standard = inertial_parameters.standard_parameters(loaded, table)
    base = base_parameters.find(loaded, standard, table)
    rng = np.random.default_rng(0)
    offset = 0.2 * rng.normal(size=loaded.n) + (
        np.array([0.0, -1.2, 0.8, 0.0, 0.5, 0.0]) if loaded.n == 6 else 0.0
    )
    series = FourierSeries(
        0.15 * rng.normal(size=(loaded.n, 4)), 0.15 * rng.normal(size=(loaded.n, 4)), offset, 5.0
    )
    stated = ramps.with_derived_limits(table, series)
    motion = ramps.plan_rest_to_rest(
        MotionConstraints(loaded, stated, standard, 0.05), series, 2, 100.0
    )
    noise = 0.01 * table.torque
    scores = {
        name: criteria.evaluate_criteria(dynamics.regressor(loaded, standard, samples), base, noise)
        for name, samples in (
            ("optimum", series.samples(series.grid(100))),
            ("exported", motion.samples(motion.grid(50.0))),
        )
    }
    margins = [
        {
            "limit": kind,
            "joint": joint,
            "time": 1.0 + 0.1 * k,
            "value": 1.0 + 0.1 * k,
            "bound": 3.0,
            "margin": 0.6 - 0.03 * k,
        }
        for k, joint in enumerate(loaded.joints)
        for kind in ("position", "velocity", "torque")
    ]
    trajectory = Trajectory(
        robot={
            "name": loaded.name,
            "source": loaded.source,
            "sha256": loaded.sha256,
            **loaded.options,
        },
        motion=motion,
        rate=100.0,
        limits=stated,
        noise=noise,
        design={
            "criterion": "a",
            "plain": False,
            "uncertainty": 0.05,
            "samples": 100,
            "starts": 2,
            "boxes": [],
        },
        criteria=scores,
        margins=margins,
        collision="collision not checked",
        seed=7,
        versions=trajectory_file.package_versions(),
    )
    root = identifiability.information_root(
        loaded, standard, motion.samples(motion.grid(100.0)), noise
    )
    analysis = identifiability.analyse_root(standard, base, root, noise, loaded)
    return trajectory, loaded, standard, base, analysis


def attempts() -> list[Attempt]:
    motion = parts("ur10e")[0].motion.fourier
    return [
        Attempt(
            number=k,
            motion=motion,
            objective=5.0 + 0.3 * k,
            history=History([0.0, 0.1], [9.0, 5.0 + 0.3 * k], [1.1, 1.0], [0, 0]),
            state=SearchState(np.zeros(1), np.zeros(1), 0.0 if k < 2 else np.inf),
        )
        for k in range(3)
    ]


@cache
def page_of(source: str = "ur10e") -> str:
    return design_page(*parts(source), attempts())


def section(page: str, key: str) -> str:
    match = re.search(rf'<section id="{key}">.*?</section>', page, flags=re.S)
    assert match, key
    return match[0]


def answer(page: str, key: str) -> str:
    match = re.search(r'<p class="answer[^"]*">(.*?)</p>', section(page, key), flags=re.S)
    assert match, key
    return match[1].replace("\u00a0", " ")


def check_page(page: str) -> None:
    assert (
        "http" not in page
        and "<script" not in page
        and "src=" not in page
        and "@import" not in page
    )
    assert all(target.startswith("#") for target in re.findall(r'href="([^"]*)"', page))
    assert not re.search(r"url\((?!#)", page)
    pictures = re.findall(r"<svg.*?</svg>", page, flags=re.S)
    assert pictures
    for picture in pictures:
        tree = ElementTree.fromstring(picture)
        assert tree.get("viewBox") and tree.get("aria-label")
    ids = re.findall(r' id="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    targets = set(re.findall(r'href="#([^"]+)"', page)) | set(re.findall(r"url\(#([^)]+)\)", page))
    assert targets <= set(ids)
    for word in ("nan", "None", "inf", "{", "np.float"):
        body = re.sub(r"<style.*?</style>", "", page, flags=re.S)
        assert not re.search(
            rf"(?<![A-Za-z]){re.escape(word)}(?![A-Za-z])", re.sub(r"<[^>]*>", " ", body)
        ), word


def test_design_report_stands_alone_and_answers_every_question() -> None:
    page = page_of()
    check_page(page)
    assert [s for s in re.findall(r'<section id="(\w+)"', page)] == list(SECTIONS)
    for key in SECTIONS:
        text = answer(page, key)
        assert text.endswith(".") and len(text) > 20, key
        assert f'href="#{key}"' in page
    for key in ("limits", "torque", "spectrum", "parts", "parameters", "more", "path", "history"):
        assert "<svg" in section(page, key), key
    assert len(page.encode()) < 1_500_000


def test_the_closest_limit_is_that_of_the_certificate() -> None:
    """Velocities have the same margins as positions, 30 % of which are promised."""
    trajectory, *context = parts("ur10e")
    promising = dataclasses.replace(
        trajectory, design={**trajectory.design, "margin": {"velocity": 0.3}}
    )
    page = design_page(promising, *context, attempts())
    assert answer(page, "limits") == (
        "Yes; closest is the velocity of wrist_3_joint at 1.50 s, with a margin of 45 %, "
        "30 % promised."
    )
    certificate = Certificate(
        tuple(
            LimitMargin(
                *(m[key] for key in ("limit", "joint", "time", "value", "bound", "margin")),
                promised_share(promising, m["limit"]),
            )
            for m in trajectory.margins
        ),
        {},
        (),
    )
    assert certificate.verdict_lines()[1] == (
        "limits: certified; nearest: velocity of wrist_3_joint, 1.5 of 3 at 1.500 s "
        "(45 % free, 30 % promised)"
    )


def test_limits_of_the_ramps_alone_are_marked() -> None:
    trajectory, *context = parts("ur10e")
    margins = [{**m, "ramps_only": True} for m in trajectory.margins]
    page = design_page(dataclasses.replace(trajectory, margins=margins), *context, attempts())
    assert "velocity (ramps)" in section(page, "limits")
    assert "velocity (ramps)" not in section(page_of(), "limits")


def test_answers_are_computed_from_the_data() -> None:
    page = page_of()
    trajectory, loaded, _, base, analysis = parts("ur10e")
    assert answer(page, "limits").startswith(
        "Yes; closest is the position of wrist_3_joint at 1.50 s"
    )
    assert answer(page, "spectrum").startswith(
        f"{analysis.identifiable_count} of {base.count} directions"
    )
    joints = dynamics.band(
        dynamics.regressor(
            loaded,
            parts("ur10e")[2],
            trajectory.motion.samples(np.linspace(0, trajectory.motion.duration, 2000)),
        ),
        parts("ur10e")[2],
        0.05,
    )
    ratio = (np.abs(joints[0]) + joints[1]).max(axis=0) / trajectory.limits.torque
    assert loaded.joints[int(np.argmax(ratio))] in answer(page, "torque")
    assert f"{100 * ratio.max():.0f} %" in answer(page, "torque")
    assert "number 0, after 1 iteration;" in answer(page, "history")
    assert "1 of 3 starts end within 5 %" in answer(page, "history")
    assert "seed 7" in answer(page, "made")
    for text in (
        loaded.sha256,
        "ur10e.toml",
        "derived",
        "1\u00a0% of each torque limit",
        "Collision not checked",
        "1 start found no motion inside all limits",
    ):
        assert text in page, text
    for joint in (*loaded.joints, *loaded.links):
        assert joint in page


def test_a_violated_limit_is_stated_on_the_first_screen() -> None:
    trajectory, *others = parts("ur10e")
    margins = [
        *trajectory.margins,
        {
            "limit": "jerk",
            "joint": "elbow_joint",
            "time": 0.5,
            "value": 130.0,
            "bound": 100.0,
            "margin": -0.3,
        },
    ]
    page = design_page(
        dataclasses.replace(trajectory, margins=margins, forced=True), *others, attempts()
    )
    assert "FAILED" in page and "Do not run this motion" in page
    assert answer(page, "limits").startswith(
        "No: 1 limit violated, the worst the jerk of elbow_joint"
    )
    assert "FAILED" not in page_of()


def test_relative_margin_is_computed_if_the_file_does_not_state_it() -> None:
    trajectory = parts("ur10e")[0]
    margins = [
        {"limit": "velocity", "joint": "elbow_joint", "time": 0.0, "value": -2.0, "bound": -2.5},
        {"limit": "position", "joint": "elbow_joint", "time": 0.0, "value": 6.0, "bound": 6.283185},
    ]
    sizes = relative_margins(dataclasses.replace(trajectory, margins=margins))
    assert [m["limit"] for _, m in sizes] == ["position", "velocity"]
    assert sizes[0][0] == pytest.approx(0.283185 / 6.283185)
    assert sizes[1][0] == pytest.approx(0.2)


def test_texts_of_files_are_escaped() -> None:
    trajectory, loaded, *others = parts("ur10e")
    markup = "<script>alert('x')</script> & \"quotes\""
    page = design_page(
        trajectory,
        dataclasses.replace(loaded, name=markup),
        *others,
        attempts(),
    )
    assert "<script" not in page
    assert "&lt;script&gt;" in page


def test_robot_with_many_joints_and_a_sliding_one(tmp_path: Path) -> None:
    path = tmp_path / "chain.urdf"
    path.write_text(chain(12), encoding="utf-8")
    page = design_page(*parts(str(path)), attempts())
    check_page(page)
    assert section(page, "limits").count("<svg") == 4
    assert "joint_3 (m)" in page and "joint_3 [N]" in page


def test_report_of_directions_without_excitation() -> None:
    trajectory, loaded, standard, base, analysis = parts("ur10e")
    root = np.zeros((6, standard.count))
    root[:, :6] = np.eye(6)
    unseen = identifiability.analyse_root(standard, base, root, trajectory.noise, loaded)
    assert any(np.isinf(d.variance) for d in unseen.directions)
    check_page(identifiability_page(loaded, standard, base, unseen, "a motion"))
    nothing = {
        "optimum": {"geometric": {"a": None, "d": None}},
        "exported": {"geometric": {"a": None, "d": None}},
    }
    page = design_page(
        dataclasses.replace(trajectory, criteria=nothing, margins=[]),
        loaded,
        standard,
        base,
        unseen,
        attempts(),
        cases=(),
    )
    check_page(page)
    assert "Limits: not checked" in page and analysis.identifiable_count > 0


def test_identifiability_report() -> None:
    _, loaded, standard, base, analysis = parts("ur10e")
    page = identifiability_page(loaded, standard, base, analysis, "trajectory.json")
    check_page(page)
    assert re.findall(r'<section id="(\w+)"', page) == ["spectrum", "parts", "parameters", "made"]
    assert "trajectory.json" in page


def pair(source: str, independent: bool = True, overlap: float = 0.3, criterion: str = "a") -> str:
    """A report with a second motion: the first, half a radian on and run faster."""
    trajectory, *others = parts(source)
    series = trajectory.motion.fourier
    moved = FourierSeries(1.2 * series.sine, series.cosine, series.offset + 0.5, series.period)
    likeness = {"overlap": overlap, "torque_correlation": dict.fromkeys(trajectory.joints, 0.45)}
    other = {**likeness, "overlap": 0.6} if independent else None
    facts = {
        **likeness,
        "independent": other,
        "criterion": {"first": 100.0, "second": 104.0},
        "width": 0.25,
        "weight": 0.5,
    }
    design = {**trajectory.design, "criterion": criterion, "validation": facts}
    second = dataclasses.replace(
        trajectory, motion=dataclasses.replace(trajectory.motion, fourier=moved)
    )
    return design_page(
        dataclasses.replace(trajectory, design=design), *others, attempts(), second=second
    )


def test_clearances_are_drawn_and_listed() -> None:
    trajectory, loaded, *others = parts("two_link")
    cell, _ = scene_file.find_cell(
        loaded, trajectory.limits, scene_file.Scene(), (), required=False
    )
    assert cell is not None
    nearest = continuous_check.least_distances(cell, trajectory.motion)
    page = design_page(trajectory, loaded, *others, attempts(), cell=cell, near=nearest)
    check_page(page)
    text = section(page, "collision")
    assert text.count("<svg") == 2 and "required [mm]" in text
    assert f"{1e3 * nearest[0].proven:.1f}" in text


def test_validation_motion_is_compared_with_the_first() -> None:
    page = pair("ur10e")
    check_page(page)
    text = answer(page, "validation")
    assert (
        text.startswith("Yes: the overlap of the motions is 0.30")
        and "another start of the design has 0.60" in text
        and text.endswith("is 4 % worse.")
    )
    drawn = section(page, "validation")
    assert drawn.count("stroke-linejoin") == 12 and all(
        joint in drawn for joint in parts("ur10e")[1].joints
    )
    assert answer(pair("two_link", overlap=0.9), "validation").startswith("Only in part")
    assert answer(pair("two_link", criterion="d"), "validation").endswith("is 4 better.")
    alone = pair("two_link", independent=False)
    check_page(alone)
    assert "another start" not in section(alone, "validation")


def test_validation_motion_of_many_joints(tmp_path: Path) -> None:
    path = tmp_path / "chain.urdf"
    path.write_text(chain(12), encoding="utf-8")
    page = pair(str(path))
    check_page(page)
    assert "joint_3 (m)" in section(page, "validation")


def test_time_budget_lists_all_candidates() -> None:
    trajectory, *others = parts("two_link")
    tried = [
        {
            "period": t,
            "harmonics": k,
            "samples": 20 * k,
            "repeats": r,
            "robot_time": r * t + 1.0,
            "value": 30.0,
            "deviation": d,
        }
        for t, k, r, d in ((4.0, 5, 6, 1.2), (8.0, 10, 3, 1.0), (8.0, 6, 3, 1.03))
    ]
    for chosen, words in (
        (2, "6 harmonics they predict within 3.0 % of the least"),
        (1, "10 harmonics they predict the least"),
    ):
        plan = {"budget": 25.0, "tolerance": 0.05, "candidates": tried, "chosen": chosen}
        page = design_page(
            dataclasses.replace(trajectory, design={**trajectory.design, "plan": plan}),
            *others,
            attempts(),
        )
        check_page(page)
        assert answer(page, "plan").startswith("25 s hold 3 periods of 8 s") and words in answer(
            page, "plan"
        )
        assert "<svg" in section(page, "plan") and "+20.0" in section(page, "plan")


def test_table_of_contents_lists_the_sections_in_order() -> None:
    page = page_of()
    contents = re.findall(r'<li><a href="#(\w+)"', page)
    assert contents == re.findall(r'<section id="(\w+)"', page)


def test_names_with_dollar_signs_and_markup_stay_text_in_figures(tmp_path: Path) -> None:
    name = "a$b_1$ & <i>"
    path = tmp_path / "chain.urdf"
    escaped = name.replace("&", "&amp;").replace("<", "&lt;")
    path.write_text(chain(2).replace('"joint_1"', f'"{escaped}"'), encoding="utf-8")
    page = design_page(*parts(str(path)), attempts())
    check_page(page)
    pictures = "".join(re.findall(r"<svg.*?</svg>", page, flags=re.S))
    assert "a$b_1$ &amp; &lt;i&gt;" in pictures and "<i>" not in pictures


def test_same_input_gives_the_same_bytes() -> None:
    assert design_page(*parts("two_link"), attempts()) == design_page(
        *parts("two_link"), attempts()
    )


def test_thinned_curve_keeps_extremes() -> None:
    t = np.linspace(0.0, 10.0, 5000)
    y = np.sin(5.0 * t)
    y[1234] = 9.0
    y[4321] = -7.0
    few_t, few_y = thin_curve(t, y, 300)
    assert len(few_t) <= 302 and few_y.max() == 9.0 and few_y.min() == -7.0
    assert np.all(np.diff(few_t) > 0.0) and few_t[0] == 0.0 and few_t[-1] == 10.0


@pytest.mark.parametrize(
    ("low", "high"), [(-9.0, 9.0), (0.0, 21.1), (-1e-6, 3e-6), (5.1, 5.3), (-4000.0, 12.0)]
)
def test_ticks_are_few_and_within_the_range(low: float, high: float) -> None:
    ticks = round_ticks(low, high, 3)
    assert 3 <= len(ticks) <= 9
    assert low - 1e-9 <= ticks[0] and ticks[-1] <= high * (1 + 1e-9)


@pytest.mark.parametrize("spread", [0.0, 1e-10, 1e-6, 1e-3, 1.0])
@pytest.mark.parametrize("middle", [0.0, 21.3, -123.456, 4000.0])
def test_ticks_of_nearly_constant_curves_differ(spread: float, middle: float) -> None:
    motion = parts("two_link")[0].motion
    t = np.linspace(0.0, motion.duration, 50)
    panels = [CurvePanel("distance", t, middle + spread * np.sin(t), (-np.inf, np.inf))]
    picture = draw_curves("distances", panels, motion, columns=2, height=80.0)
    labels = re.findall(r'text-anchor="end"[^>]*>([^<]*)</text>', picture)
    assert len(labels) >= 3 and len(set(labels)) == len(labels)


def test_number_format() -> None:
    assert [number(v) for v in (1.23456, -0.05, 0.0, 2.28e7, 3.1e-7, None, float("inf"))] == [
        "1.235",
        "−0.05",
        "0",
        "2.28·10⁷",
        "3.1·10⁻⁷",
        "–",
        "∞",
    ]

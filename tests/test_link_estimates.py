"""Masses with deviations and the share that the data decide; the identified URDF says both."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from shared_inputs import INPUTS, needs_inputs
from synthetic_recordings import FRICTION_WIDTH, random_fourier, synthetic_recording

from excite import api
from excite.api.identification_result import IdentificationResult
from excite.identification import consistency, identification
from excite.identification.link_estimates import link_estimates
from excite.identification.regression import IdentificationModel
from excite.identification.urdf_export import identified_urdf
from excite.robot import base_parameters, inertial_parameters
from excite.robot.limits import resolve
from excite.robot.robot import load, locate

REPORTS = Path() if INPUTS is None else INPUTS / "reports"


@pytest.fixture(scope="module")
def result() -> IdentificationResult:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return api.identify("ur5e", [REPORTS / "04-wrap_ur_mon.csv"])


@needs_inputs
def test_the_prior_decides_the_mass_that_no_torque_shows(result):
    identification = result.identification
    estimates = link_estimates(
        identification.model.parameters, identification.posterior, identification.prior
    )
    links = {link.name: link for link in estimates}
    # the first link turns about a vertical axis, so its mass loads no joint
    assert links["shoulder_link"].is_prior and links["shoulder_link"].mass_share < 0.1
    assert not links["forearm_link"].is_prior
    for link in links.values():
        assert 0.0 <= link.mass_share <= 1.0 and 0.0 <= link.centre_share <= 1.0
        assert link.mass_deviation > 0.0 and (link.centre_deviation > 0.0).all()


@needs_inputs
def test_files_say_which_masses_are_the_priors(result):
    contents = result.contents()
    comment = contents["identified.urdf"].split("-->")[0]
    assert "04-wrap_ur_mon.csv" in comment and "Identified by excite" in comment
    assert comment.count("the prior's") >= 2  # the heading, and the first link
    entry = result.document()["link_estimates"][0]
    assert entry["mass"]["decided_by"] == "prior" and entry["mass"]["std"] > 0.0
    page = contents["report.html"]
    assert "the prior&#39;s" in page and "torque error of all joints" in page
    ElementTree.fromstring(contents["identified.urdf"])  # our own text


@needs_inputs
def test_the_count_with_the_noise_of_a_design_is_stated(result):
    counted = result.identification.analysis.identifiable_count
    assert 0 < result.assumed_count < counted


def test_meshes_are_found_from_the_new_place(tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "arm.stl").write_bytes(b"solid")
    text = locate("two_link").read_text(encoding="utf-8")
    visual = (
        '<visual><geometry><mesh filename="meshes/arm.stl"/></geometry></visual>'
        '<visual><geometry><mesh filename="package://arm/arm.stl"/></geometry></visual>'
        '<visual><geometry><mesh filename="absent.stl"/></geometry></visual>'
    )
    path = tmp_path / "r.urdf"
    path.write_text(text.replace("</link>", f"{visual}</link>", 1), encoding="utf-8")
    robot = load(str(path))
    parameters = inertial_parameters.standard_parameters(robot, resolve(robot))
    urdf = identified_urdf(
        robot, parameters, parameters.nominal, np.full(robot.n, 0.003), ["a -- b"]
    )
    meshes = [str(mesh.get("filename")) for mesh in ElementTree.fromstring(urdf).iter("mesh")]
    assert meshes == [
        str(tmp_path / "meshes" / "arm.stl"),
        "package://arm/arm.stl",
        "absent.stl",
    ]


def test_masses_that_no_torque_shows_are_uncertain_next_to_an_unknown_tool():
    """The tool presses bodies against the edge of the consistent set, which shows no mass."""
    robot = load("ur5e")
    table = resolve(robot)
    parameters = inertial_parameters.standard_parameters(robot, table)
    base = base_parameters.find(robot, parameters, table)
    model = IdentificationModel(robot, parameters, base, np.full(robot.n, FRICTION_WIDTH))
    truth = consistency.consistent_nominal(parameters)
    tool = pin.Inertia(2.0, np.array([0.0, 0.0, 0.1]), 1e-3 * np.eye(3))
    truth[10 * (robot.n - 1) : 10 * robot.n] += tool.toDynamicParameters()
    recording = synthetic_recording(model, truth, random_fourier(robot.n), 2, 0.1)
    result = identification.identify(robot, parameters, base, [recording])
    links = link_estimates(parameters, result.posterior, result.prior)
    for link, mass in zip(links, truth[: 10 * robot.n : 10], strict=True):
        assert abs(link.mass - mass) < 3.0 * link.mass_deviation

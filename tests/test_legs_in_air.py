"""A legged robot on a stand: design with all limbs, clearance between legs, joint parameters."""

from __future__ import annotations

import pytest

from excite.api import design, identify, simulate
from excite.designer.options import DesignOptions


def legs_urdf() -> str:
    """Return a trunk with two legs of two joints that meet where both hips roll inwards."""
    parts = [
        '<robot name="legs"><link name="trunk"><inertial><mass value="8"/><inertia ixx="0.1" '
        'ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>'
    ]
    for side, sign in (("left", 1), ("right", -1)):
        for name, parent, origin, axis, mass in (
            ("hip", "trunk", f"0 {0.1 * sign} 0", "1 0 0", 2.0),
            ("knee", f"{side}_thigh", "0 0 -0.3", "0 1 0", 1.0),
        ):
            child = f"{side}_{'thigh' if name == 'hip' else 'shank'}"
            parts.append(
                f'<link name="{child}"><inertial><origin xyz="0.01 0.005 -0.14"/>'
                f'<mass value="{mass}"/><inertia ixx="{0.015 * mass}" ixy="0" ixz="0" '
                f'iyy="{0.014 * mass}" iyz="0" izz="{0.002 * mass}"/></inertial>'
                '<collision><origin xyz="0 0 -0.15"/><geometry><cylinder radius="0.04" '
                'length="0.26"/></geometry></collision></link>'
                f'<joint name="{side}_{name}" type="revolute"><parent link="{parent}"/>'
                f'<child link="{child}"/><origin xyz="{origin}"/><axis xyz="{axis}"/>'
                '<limit lower="-0.9" upper="0.9" velocity="6" effort="60"/>'
                '<dynamics damping="0.3" friction="0.5"/></joint>'
            )
    return "".join([*parts, "</robot>"])


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    folder = tmp_path_factory.mktemp("legs")
    (folder / "legs.urdf").write_text(legs_urdf(), encoding="utf-8")
    urdf = folder / "legs.urdf"
    result = design(
        urdf,
        period=5.0,
        harmonics=4,
        options=DesignOptions(starts=1, jobs=1, iterations=40),
        progress=lambda text: None,
    )
    result.save(folder)
    recording = simulate(urdf, folder / "trajectory.json")
    recording.save(folder / "recording.csv")
    model = identify(urdf, [folder / "recording.csv"], progress=lambda text: None)
    return result, recording, model


def test_the_legs_keep_clear_of_each_other(identified):
    certificate = identified[0].delivery.certificate
    assert certificate.ok
    pairs = {margin.joint for margin in certificate.margins if margin.limit == "clearance"}
    assert any("left" in pair and "right" in pair for pair in pairs)


def test_friction_and_armature_of_each_leg_are_in_their_intervals(identified):
    _, recording, model = identified
    document = model.document()
    parameters = {entry["name"]: entry for entry in document["base_parameters"]}
    drive = recording.truth["drive"]
    inside, count = 0, 0
    for symbol, kind in (("Ia", "inertia"), ("Fv", "viscous"), ("Fc", "coulomb")):
        for number, joint in enumerate(document["joints"], start=1):
            entry = parameters.get(f"{symbol}{number}")
            if entry is None or entry["expression"] != f"{symbol}{number}":
                continue  # an armature that no motion separates from the link's inertia
            lower, upper = entry["interval"]
            inside += lower <= drive[kind][joint] <= upper
            count += 1
    assert count >= 8
    assert inside >= count - 1

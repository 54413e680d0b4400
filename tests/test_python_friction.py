"""The generated friction module: its torque is that of the model, alone and in MuJoCo."""

from __future__ import annotations

import ast
import dataclasses
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_cases import effect_entry
from hypothesis import given
from hypothesis import strategies as st
from identified_models import model_torque, random_states, read_model, write_model
from synthetic_recordings import random_fourier

import excite
from excite._types import FloatArray
from excite.diagnosis import fitted_effects
from excite.effects.friction_runtime import Friction
from excite.effects.load_friction import LOAD_FRICTION
from excite.identification.identified_model import IdentifiedModel
from excite.recordings import Recording
from excite.robot.samples import Samples

BUILD_UP = {"reach": 5e-4, "last_reach": 0.1}
BUILD_UP |= {f"share_{i}": {2: 0.3, 5: 0.5}.get(i, 0.0) for i in range(20)}
"""How a friction builds up in Maxwell-slip elements, a fifth of it at once."""
FRICTION_EFFECTS = {
    "asymmetric_viscous": effect_entry("asymmetric_viscous", "joint_2", {}, 0.3),
    "stribeck": effect_entry(
        "stribeck", "joint_1", {"top_speed": 2.0}, *(0.4, 0.0, 0.2, 0.1, 0.0, 0.3, 0.2, 0.1)
    ),
    "stribeck, built up": effect_entry(
        "stribeck", "joint_1", {"top_speed": 2.0} | BUILD_UP, *(0.4, 0, 0.2, 0.1, 0, 0.3, 0.2, 0.1)
    ),
    "nonlinear_viscous": effect_entry(
        "nonlinear_viscous", "joint_2", {"top_speed": 2.0}, *(0.5, 0.2, 0.1, 0.3, 0.1, 0.2, 0.1, 0)
    ),
    "nonlinear_viscous, beyond the fitted speeds": effect_entry(
        "nonlinear_viscous", "joint_2", {"top_speed": 0.5}, *(0.5, 0.2, 0.1, 0.3, 0.1, 0.2, 0.1, 0)
    ),
    "nonlinear_viscous, convex": effect_entry(
        "nonlinear_viscous", "joint_2", {"top_speed": 2.0}, *(0, 0, 0, 0, 0, 0, 0.4, 0.3)
    ),
    "drag": effect_entry("drag", "joint_1", {}, 0.4),
    "load_friction": effect_entry(
        "load_friction", "joint_1", {"dense": 1.0, "scale": 9.0}, 0.1, 0.05, 0.0, 0.02
    ),
    "load_friction, built up": effect_entry(
        *("load_friction", "joint_1", {"dense": 1.0, "scale": 9.0} | BUILD_UP),
        *(0.1, 0.05, 0.0, 0.02),
    ),
    "position_friction": effect_entry(
        "position_friction",
        "joint_1",
        {"order": 2.0, "waves": 2.0, "low": -1.0, "high": 1.5},
        *(0.5, 0.2, 0.1, -0.3),
    ),
    "friction": effect_entry("friction", "joint_2", {}, 0.4, 0.2),
    "torque_offset": effect_entry("torque_offset", "joint_2", {}, 0.4),
    "spring": effect_entry("spring", "joint_2", {"form": 3.0}, 0.4, 0.2, 0.1),
    "spring, wave": effect_entry("spring", "joint_2", {"form": 1.0}, 0.4, 0.2),
    "spring, waves": effect_entry("spring", "joint_2", {"form": 4.0}, 0.4, 0.2, 0.3, 0.1),
    "spring, slow wave": effect_entry(
        "spring", "joint_2", {"order": 1.4, "about": 0.2, "low": -0.5, "high": 0.9}, 1, 2, 3
    ),
    "spring, bend": effect_entry("spring", "joint_2", {"bend": 0.3}, 1.0, 2.0),
    "spring, curve": effect_entry(
        "spring",
        "joint_2",
        {"waves": 6.0, "low": -0.4, "high": 0.5},
        *(0.5, 0.3, -0.2, 0.1, 0.1, 0.05),
    ),
    "torque_ripple": effect_entry(
        "torque_ripple", "joint_2", {"order": 5.0, "load": 4.0}, 0.3, 0.2, 0.1, 0.4
    ),
    "coupling": effect_entry("coupling", "joint_1", {"ratio": -0.7}, 0.2, 0.5, 0.1)
    | {"from": "joint_2"},
    "coupling, light": effect_entry("coupling", "joint_1", {"ratio": 0.7, "light": 1.0}, 0.2, 0.5)
    | {"from": "joint_2"},
    "hysteresis": effect_entry(
        "hysteresis",
        "joint_1",
        BUILD_UP,
        *(0.1, 0.2, 0, 0.3, 0.2, 0, 0.1, 0.2, 0, 0.1, 0, 0.1, 0, 0, 0, 0, 0, 0, 0, 0),
        *(0.05, -0.03, 0.0),
    ),
    "hysteresis, damped": effect_entry(
        "hysteresis",
        "joint_1",
        BUILD_UP,
        *(0, 0, 0.3, 0, 0, 0.5, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
        *(0.05, -0.03, 0.07),
    ),
}
"""Effects of every form that is a torque of one joint."""
WIDTH = 0.1
"""Width of friction at which its steps are resolved by the samples [rad/s]."""


def module(text: str) -> dict[str, Any]:
    """Return the names of a generated module."""
    scope: dict[str, Any] = {"__name__": "friction"}
    exec(compile(text, "friction.py", "exec"), scope)
    return scope


def unfiltered(model: IdentifiedModel) -> tuple[FloatArray, Samples, FloatArray, FloatArray]:
    """Torque of the effects of a model by its own prediction, where its filter changes nothing.

    Returns:
        Torque, shape (N, n), and the motion, the load, and a mask of the samples inside.
    """
    fourier, rate = random_fourier(2, 3, period=2.0), 1000.0
    t = np.arange(round(2.0 * fourier.period * rate) + 1) / rate
    recording = Recording("a.csv", model.robot.joints, t, fourier.samples(t).q, row_times=t)
    wide = dataclasses.replace(model, hertz=0.4 * rate)
    without = dataclasses.replace(wide, effects=())
    torque = fitted_effects.predict(wide, recording)[1]
    torque -= fitted_effects.predict(without, recording)[1]
    motion = fourier.samples(t)
    rigid = model.psi.copy()
    rigid[10 * len(model.robot.links) :] = 0.0
    bare = dataclasses.replace(model, psi=rigid)
    return torque, motion, bare.torque(motion, motion.dq), (t > 0.5) & (t < t[-1] - 0.5)


DENSE = tuple(
    FRICTION_EFFECTS[name]
    for name in (
        *("stribeck", "nonlinear_viscous", "load_friction", "position_friction", "spring, curve"),
        *("torque_ripple", "hysteresis, damped", "asymmetric_viscous"),
    )
)
"""Effects of a robot with several frictions at each joint, as a diagnosis writes them."""


@pytest.mark.parametrize(
    "effects",
    [*((effect,) for effect in FRICTION_EFFECTS.values()), DENSE],
    ids=[*FRICTION_EFFECTS, "dense"],
)
def test_the_module_gives_the_torque_that_the_model_predicts(effects, tmp_path):
    path = write_model(tmp_path, "two_link", effects)
    model = dataclasses.replace(read_model(path), widths=np.full(2, WIDTH))
    exported = excite.export_model(path, "python-friction")
    assert not exported.remainders
    scope = module(exported.text)
    friction = scope["Friction"](scope["TABLE"] | {"widths": [WIDTH, WIDTH]})
    expected, motion, load, inside = unfiltered(model)
    base = scope["Friction"](
        scope["TABLE"]
        | {"widths": [WIDTH, WIDTH]}
        | {"terms": [t for t in scope["TABLE"]["terms"] if t["effect"].startswith("base")]}
    )
    torque = np.empty_like(expected)
    for k in range(len(motion)):
        state = (motion.q[k], motion.dq[k], load[k], motion.ddq[k])
        torque[k] = friction.torque(*state) - base.torque(*state)
    size = np.sqrt(np.mean(expected**2))
    error = np.sqrt(np.mean((torque - expected)[inside] ** 2))
    assert size > 0.01 and error < 0.01 * size


def added_by_curve(folder: Path, share: float, *coefficients: float, **further: float) -> float:
    """Return what curves up to 0.5 rad/s add to the friction at a multiple of that speed [N m]."""
    values = {"top_speed": 0.5, **further}
    effect = effect_entry("nonlinear_viscous", "joint_2", values, *coefficients)
    with_curve, without = (
        module(
            excite.export_model(write_model(folder, "two_link", effects), "python-friction").text
        )["FRICTION"]
        for effects in ((effect,), ())
    )
    speed = np.array([0.0, share * values["top_speed"]])
    return float((with_curve.torque(0 * speed, speed) - without.torque(0 * speed, speed))[1])


@pytest.mark.parametrize("share", [1.5, 3.0, -2.0])
def test_beyond_the_fitted_speeds_no_curve_rises_by_more_than_viscous_friction(tmp_path, share):
    sign, size = np.sign(share), abs(share)
    eyring = np.arcsinh(size / 0.1) / np.arcsinh(1.0 / 0.1) - size
    assert added_by_curve(tmp_path, share, 0, 2.0, 0, 0, 0, 0, 0, 0) == pytest.approx(
        2.0 * sign * eyring
    )
    assert added_by_curve(tmp_path, share, 0, 0, 0, 0, 0, 0, 0.4, 0.3) == pytest.approx(
        0.0, abs=1e-12
    )
    # without viscous friction that makes up for the line, the curve alone remains
    tanh = (0, 0, 0, 0.5, 0, 0, 0, 0)
    assert 0 <= sign * added_by_curve(tmp_path, share, *tanh, line_share=0.0) < 1e-6


def test_with_links_and_rotors_it_is_the_inverse_dynamics_of_the_model(tmp_path):
    path = write_model(tmp_path, "ur5e")
    model = read_model(path)
    friction = module(excite.export_model(path, "python-friction").text)["FRICTION"]
    motion = random_states(model, 100)
    psi = model.psi.copy()
    for kind in ("viscous", "coulomb", "offset"):
        psi[model.layout.block(kind)] = 0.0
    rigid = dataclasses.replace(model, psi=psi).torque(motion, motion.dq)
    torque = friction.torque(motion.q, motion.dq)  # many robots at once
    np.testing.assert_allclose(rigid + torque, model_torque(model, motion), atol=1e-9)


def test_hysteresis_is_passive_and_independent_of_rate_and_of_repeated_calls(tmp_path):
    effect = FRICTION_EFFECTS["hysteresis"]
    path = write_model(tmp_path, "two_link", (effect,))
    friction = module(excite.export_model(path, "python-friction").text)["FRICTION"]
    q = 0.2 * np.sin(np.linspace(0.0, 4.0 * np.pi, 801))
    states = np.column_stack([q, np.zeros_like(q)])
    force = np.array([friction.torque(x, 0 * x)[0] for x in states])
    friction.reset()
    twice = np.array([(friction.torque(x, 0 * x), friction.torque(x, 0 * x))[1][0] for x in states])
    np.testing.assert_array_equal(force, twice)
    work = np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(q))
    assert work > 0.0  # over whole cycles it only takes energy


def test_the_module_needs_numpy_only(tmp_path):
    path = write_model(tmp_path, "two_link", (FRICTION_EFFECTS["hysteresis"],))
    file = excite.export_model(path, "python-friction").save(tmp_path / "friction.py")
    names = {
        (node.module if isinstance(node, ast.ImportFrom) else node.names[0].name)
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Import | ast.ImportFrom)
    }
    assert names == {"__future__", "typing", "numpy"}
    code = "import friction; print(friction.FRICTION.torque([0.1, 0.2], [1.0, -1.0], [2.0, 1.0]))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_mujoco_with_the_module_has_the_torque_of_the_model(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    effects = tuple(FRICTION_EFFECTS[name] for name in ("load_friction", "drag", "torque_ripple"))
    path = write_model(tmp_path, "two_link", effects)
    model, motion = read_model(path), random_states(read_model(path), 50)
    scope = module(excite.export_model(path, "python-friction").text)
    compiled = mujoco.MjModel.from_xml_string(excite.export_model(path, "mjcf").text)
    compiled.dof_frictionloss[:] = 0.0
    data, torque = mujoco.MjData(compiled), np.empty_like(motion.q)
    scope["install"](mujoco, compiled, scope["FRICTION"])
    try:
        for k in range(len(motion)):
            data.qpos[:], data.qvel[:], data.qacc[:] = motion.q[k], motion.dq[k], motion.ddq[k]
            mujoco.mj_inverse(compiled, data)
            torque[k] = data.qfrc_inverse
    finally:
        mujoco.set_mjcb_passive(None)
    psi = model.psi.copy()
    psi[10 * len(model.robot.links) :] = 0.0
    load = dataclasses.replace(model, psi=psi).torque(motion, motion.dq)
    beyond = scope["FRICTION"].torque(motion.q, motion.dq, load)
    friction = model.psi[model.layout.block("coulomb")]
    rotors = model.psi[model.layout.block("rotor_inertia")] * motion.ddq
    fast = np.abs(motion.dq) > 0.1  # below, the explicit integration widens the sign
    expected = load + rotors + beyond - friction * np.tanh(motion.dq / model.widths)
    np.testing.assert_allclose(torque[fast], expected[fast], atol=1e-6)


def test_effects_that_are_no_friction_are_named(tmp_path):
    effects = (effect_entry("delay", None, {"measured": 1.0}, 0.004),)
    path = write_model(tmp_path, "two_link", effects)
    exported = excite.export_model(path, "python-friction")
    assert [part.name for part in exported.remainders] == ["delay"]
    assert "delay: torque unknown" in exported.text


@pytest.mark.parametrize("name", ["mjcf", "urdf", "sdf", "isaaclab", "c", "python-friction"])
def test_the_header_names_each_effect_of_a_dense_robot_that_the_file_does_not_hold(name, tmp_path):
    delay = effect_entry("delay", None, {"measured": 1.0}, 0.004)
    exported = excite.export_model(write_model(tmp_path, "two_link", (*DENSE, delay)), name)
    names = {part.name for part in exported.remainders} - {"rotor inertia", "offset"}
    held = {
        "isaaclab": {"stribeck"},
        "c": {effect["effect"] for effect in DENSE},
        "python-friction": {effect["effect"] for effect in DENSE},
    }
    assert names == {effect["effect"] for effect in (*DENSE, delay)} - held.get(name, set())
    assert all(f"{effect}" in exported.text for effect in names)


@given(st.tuples(*[st.floats(0.0, 2.0)] * 4), st.floats(-50.0, 50.0), st.sampled_from([-1.0, 1.0]))
def test_load_friction_of_allowed_coefficients_never_drives(coefficients, load, speed):
    assert LOAD_FRICTION.nonnegative == (True,) * len(coefficients)
    values = {"dense": 1.0, "scale": 9.0}
    entry = ("load_friction", 0, -1, values, list(coefficients), [])
    names = ("effect", "joint", "other", "values", "coefficients", "held_by")
    friction = Friction(
        {"joints": ["a"], "widths": [1e-3], "terms": [dict(zip(names, entry, strict=True))]}
    )
    torque = friction.torque(np.zeros(1), np.array([speed]), np.array([load]))
    assert torque[0] * speed >= -1e-12

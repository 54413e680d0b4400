"""The C file of an identified robot: compiled, it gives the torque of the model."""

from __future__ import annotations

import ctypes
import dataclasses
import shutil
import subprocess
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from identified_models import model_torque, random_states, read_model, write_model
from test_python_friction import DENSE, FRICTION_EFFECTS, WIDTH, module, unfiltered

import excite

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler: cc, gcc or clang")


def compiled(path: Path, folder: Path) -> ctypes.CDLL:
    """Export a model as C and compile it without any other file, warnings as errors."""
    source = excite.export_model(path, "c").save(folder / "robot.c")
    library = folder / "robot.so"
    command = [str(COMPILER), "-std=c99", "-O1", "-Wall", "-Wno-unused-function", "-Werror"]
    subprocess.run(
        [*command, "-shared", "-fPIC", str(source), "-lm", "-o", str(library)], check=True
    )
    return ctypes.CDLL(str(library))


def call(function, *arguments: np.ndarray) -> np.ndarray:
    """Call a function of the library row by row."""
    number = ctypes.POINTER(ctypes.c_double)
    out = np.empty_like(arguments[0])
    for k, rows in enumerate(zip(*arguments, strict=True)):
        values = [np.ascontiguousarray(row) for row in rows]
        tau = np.empty(out.shape[1])
        function(*(value.ctypes.data_as(number) for value in (*values, tau)))
        out[k] = tau
    return out


@needs_compiler
@pytest.mark.parametrize("name", ["two_link", "ur5e", "panda"])
def test_the_c_file_gives_the_torque_of_the_model(name, tmp_path):
    path = write_model(tmp_path, name)
    model, library = read_model(path), compiled(path, tmp_path)
    motion = random_states(model, 200)
    torque = call(library.excite_inverse_dynamics, motion.q, motion.dq, motion.ddq)
    np.testing.assert_allclose(torque, model_torque(model, motion), atol=1e-9)
    still = np.zeros_like(motion.q)
    psi = model.psi.copy()
    psi[10 * len(model.robot.links) :] = 0.0
    links = dataclasses.replace(model, psi=psi)
    at_rest = dataclasses.replace(motion, dq=still, ddq=still)
    expected = links.torque(at_rest, still)
    np.testing.assert_allclose(call(library.excite_gravity, motion.q), expected, atol=1e-9)
    load = links.torque(motion, motion.dq)
    rotors = model.psi[model.layout.block("rotor_inertia")] * motion.ddq
    friction = call(library.excite_friction, motion.q, motion.dq, load)
    np.testing.assert_allclose(load + rotors + friction, torque, atol=1e-9)


@needs_compiler
@pytest.mark.parametrize(
    "name",
    [
        *("stribeck", "nonlinear_viscous", "load_friction", "torque_ripple", "spring, curve"),
        *("spring, bend", "coupling"),
    ],
)
def test_effects_without_memory_are_in_the_c_file(name, tmp_path):
    path = write_model(tmp_path, "two_link", (FRICTION_EFFECTS[name],))
    text = path.read_text(encoding="utf-8").replace("0.005", str(WIDTH))
    path.write_text(text, encoding="utf-8")
    model, library = read_model(path), compiled(path, tmp_path)
    expected, motion, _, inside = unfiltered(model)
    torque = call(library.excite_inverse_dynamics, motion.q, motion.dq, motion.ddq)
    without = dataclasses.replace(model, effects=())
    error = torque - model_torque(without, motion) - expected
    assert np.sqrt(np.mean(error[inside] ** 2)) < 0.01 * np.sqrt(np.mean(expected**2))


@needs_compiler
def test_hysteresis_has_a_state_that_is_stepped(tmp_path):
    built_up = FRICTION_EFFECTS["stribeck, built up"], FRICTION_EFFECTS["load_friction, built up"]
    plain = FRICTION_EFFECTS["hysteresis"] | {"joint": "joint_2"}
    effects = (*DENSE, *built_up, plain)
    path = write_model(tmp_path, "two_link", effects)
    path.write_text(path.read_text(encoding="utf-8").replace("0.005", str(WIDTH)), encoding="utf-8")
    exported = excite.export_model(path, "c")
    assert not exported.remainders
    model, library = read_model(path), compiled(path, tmp_path)
    expected, motion, load, inside = unfiltered(model)
    text = excite.export_model(path, "python-friction").text
    friction = module(text)["FRICTION"]
    stated = np.array(
        [friction.torque(*row) for row in zip(motion.q, motion.dq, load, motion.ddq, strict=True)]
    )
    state = (ctypes.c_double * 1000)()  # larger than the struct
    number = ctypes.POINTER(ctypes.c_double)
    library.excite_hysteresis_reset(state, motion.q[0].ctypes.data_as(number))
    memory = call(partial(library.excite_hysteresis, state), motion.q, motion.dq, load)
    without = call(library.excite_friction, motion.q, motion.dq, load)
    np.testing.assert_allclose(without + memory, stated, atol=1e-9)
    # and the torque that `excite predict` has along the same motion
    torque = call(library.excite_inverse_dynamics, motion.q, motion.dq, motion.ddq) + memory
    bare = dataclasses.replace(model, effects=())
    error = torque - model_torque(bare, motion) - expected
    assert np.sqrt(np.mean(error[inside] ** 2)) < 0.01 * np.sqrt(np.mean(expected**2))


@needs_compiler
def test_a_step_at_the_same_position_changes_no_state(tmp_path):
    path = write_model(tmp_path, "two_link", (FRICTION_EFFECTS["hysteresis"],))
    library, number = compiled(path, tmp_path), ctypes.POINTER(ctypes.c_double)
    q = np.column_stack([0.2 * np.sin(np.linspace(0.0, 4.0 * np.pi, 801)), np.zeros(801)])
    force = []
    for rows in (q, np.repeat(q, 2, axis=0)):
        state = (ctypes.c_double * 1000)()
        library.excite_hysteresis_reset(state, rows[0].ctypes.data_as(number))
        force.append(call(partial(library.excite_hysteresis, state), rows, 0.0 * rows, rows)[:, 0])
    np.testing.assert_array_equal(force[0], force[1][1::2])
    assert np.sum(0.5 * (force[0][1:] + force[0][:-1]) * np.diff(q[:, 0])) > 0.0


def test_only_a_robot_with_hysteresis_has_its_state(tmp_path):
    assert "excite_hysteresis" not in excite.export_model(write_model(tmp_path, "ur5e"), "c").text

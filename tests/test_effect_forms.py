"""Parameters of the contract, each measured on the model form that the simulator hides."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

pytest.importorskip("mujoco")

from concealed_trial.score import compare_answer, with_contract_values

from excite._types import FloatArray
from excite.simulator.actuator import JointActuators
from excite.simulator.effect_instance import EffectInstance
from excite.simulator.effects import EFFECT_TYPES, FORM_FAMILIES
from excite.simulator.effects.effect_type import EffectSite, smooth_sign
from excite.simulator.physical_effect import JointStates, PhysicalEffect

ONE_JOINT = np.ones(1)
ACTUATORS = JointActuators(
    inertia=0.4 * ONE_JOINT,
    viscous=0.5 * ONE_JOINT,
    coulomb=1.5 * ONE_JOINT,
    width=4e-3 * ONE_JOINT,
    offset=0.2 * ONE_JOINT,
)
SITE = EffectSite(1, 0, 0, 60.0 * ONE_JOINT, 3.0 * ONE_JOINT, ACTUATORS, "a", "link")
USUAL = {
    "stribeck": {"amplitude": 1.1, "velocity": 0.07},
    "position_friction": {"amplitude": 0.4, "waves": 2.0, "phase": 0.6},
    "torque_ripple": {"order": 7.0, "amplitude": 0.9, "phase": 0.4},
    "encoder_error": {"amplitude": 2e-3, "order": 3.0, "phase": -0.8},
    "thermal_drift": {"change": -0.4, "time_constant": 12.0},
    "hysteresis": {"amplitude": 0.8, "stiffness": 500.0},
    "torque_saturation": {"loss": 0.1, "at": 24.0},
    "asymmetric_viscous": {"positive": 0.2, "negative": -0.3},
    "delay": {"seconds": 3e-3},
}


def effect_physics(name: str, family: str, **changed: float) -> PhysicalEffect:
    return EFFECT_TYPES[name].forms[family](SITE, {**USUAL[name], **changed})


def truth_entry(name: str, family: str, **changed: float) -> dict[str, object]:
    """Return an effect as the ground truth states it."""
    return {
        **EffectInstance(name, "a", family, {**USUAL[name], **changed}).to_document(),
        "severity": 5.0,
    }


def contract_values(name: str, family: str, **changed: float) -> Mapping[str, float]:
    """Return the values with which an answer is compared."""
    case = {"truth": {"drive": {"viscous": {"a": 0.5}}}}
    return {
        key: parameter["value"]
        for key, parameter in with_contract_values(truth_entry(name, family, **changed), case)[
            "parameters"
        ].items()
    }


def torque_of(
    effect: PhysicalEffect,
    q: FloatArray | float = 0.0,
    v: FloatArray | float = 1.0,
    t: FloatArray | float = 0.0,
) -> FloatArray:
    """Return the torque at the joint without acceleration and load."""
    t, q, v = np.broadcast_arrays(t, q, v)
    out = effect.torque(
        JointStates(t, q[..., None], v[..., None], 0.0 * q[..., None], 0.0 * q[..., None]),
        np.empty(0),
    )
    assert out is not None
    return np.asarray(out[..., 0])


def fourier_amplitude(values: FloatArray, angle: FloatArray) -> float:
    """Return the amplitude of a Fourier component over full turns."""
    return float(2.0 * np.abs(np.mean(values * np.exp(1j * angle))))


# -- parameters that need a conversion --------------------------------------------------------


@pytest.mark.parametrize("family", FORM_FAMILIES)
@pytest.mark.parametrize("velocity", [0.02, 0.3])
def test_stribeck_friction_is_down_to_1_over_e_at_its_velocity(family, velocity):
    expected = contract_values("stribeck", family, velocity=velocity)
    v = np.array([1e-7, expected["velocity"]])
    most, there = torque_of(
        effect_physics("stribeck", family, velocity=velocity), v=v
    ) / smooth_sign(v)
    assert there / most == pytest.approx(np.exp(-1.0))
    assert most == pytest.approx(expected["amplitude"])


@pytest.mark.parametrize("family", FORM_FAMILIES)
@pytest.mark.parametrize("phase", [0.0, 0.6, -2.5, np.pi])
def test_position_friction_varies_by_its_amplitude(family, phase):
    torques = torque_of(
        effect_physics("position_friction", family, phase=phase), q=np.linspace(0.0, np.pi, 20001)
    ) / smooth_sign(1.0)
    assert 0.5 * np.ptp(torques) == pytest.approx(
        contract_values("position_friction", family, phase=phase)["amplitude"], rel=1e-4
    )


@pytest.mark.parametrize("family", FORM_FAMILIES)
def test_ripple_has_its_amplitude_at_its_order(family):
    # a hundred turns are full periods of both meshes
    q, expected = (
        np.linspace(0.0, 200.0 * np.pi, 400000, endpoint=False),
        contract_values("torque_ripple", family),
    )
    assert fourier_amplitude(
        torque_of(effect_physics("torque_ripple", family), q=q), expected["order"] * q
    ) == pytest.approx(expected["amplitude"])


@pytest.mark.parametrize("family", FORM_FAMILIES)
def test_encoder_error_has_its_amplitude_at_its_order(family):
    q, expected = (
        np.linspace(0.0, 2.0 * np.pi, 20000, endpoint=False),
        contract_values("encoder_error", family),
    )
    assert fourier_amplitude(
        effect_physics("encoder_error", family).measured_position(q[:, None])[:, 0] - q,
        expected["order"] * q,
    ) == pytest.approx(expected["amplitude"])


def test_thermal_drift_has_done_1_minus_1_over_e_after_its_time_constant():
    expected = contract_values("thermal_drift", "tuning")
    there, end = torque_of(
        effect_physics("thermal_drift", "tuning"), t=np.array([expected["time_constant"], 1e6])
    )
    assert there / end == pytest.approx(1.0 - np.exp(-1.0))
    assert end / (ACTUATORS.friction_torque(ONE_JOINT) - ACTUATORS.offset)[0] == pytest.approx(
        expected["change"]
    )


def test_self_heating_friction_changes_by_a_share_that_depends_on_speed():
    """`change` is that of viscous friction; at low speed the total changes by half of it."""
    effect, warm = effect_physics("thermal_drift", "scored"), np.ones(1)
    share = [
        effect.torque(
            JointStates(0.0, 0.0 * ONE_JOINT, v * ONE_JOINT, 0.0 * ONE_JOINT, 0.0 * ONE_JOINT), warm
        )[0]
        / (0.5 * v + 1.5)
        for v in (0.1, 1.2, 1e5)
    ]
    assert share == pytest.approx([-0.206, -0.257, -0.4], abs=1e-3)
    assert set(contract_values("thermal_drift", "scored")) == {"time_constant"}


# -- parameters that need none ----------------------------------------------------------------


@pytest.mark.parametrize("family", FORM_FAMILIES)
def test_hysteresis_has_its_presliding_stiffness_and_amplitude(family):
    effect, expected = effect_physics("hysteresis", family), contract_values("hysteresis", family)
    steps = np.array([1e-8, *np.full(2000, 1e-4)])
    z, torques = np.zeros(effect.state_size), []
    for step in steps:
        x = JointStates(np.zeros(()), np.zeros(1), np.array([step]), np.zeros(1), np.zeros(1))
        z = effect.advance_state(x, z, 1.0)
        torques.append(float(effect.torque(x, z)[0]))
    assert torques[0] / steps[0] == pytest.approx(expected["stiffness"], rel=1e-3)
    assert torques[-1] == pytest.approx(expected["amplitude"], rel=1e-6)


@pytest.mark.parametrize("family", FORM_FAMILIES)
def test_delay_shifts_a_ramp_by_its_seconds(family):
    t = np.linspace(0.0, 1.0, 5)
    np.testing.assert_allclose(
        effect_physics("delay", family).measured_torque(lambda at: at[:, None], t)[:, 0],
        t - contract_values("delay", family)["seconds"],
    )


# -- comparison with answers ------------------------------------------------------------------


def test_ground_truth_states_the_values_of_the_model_form():
    case = {"truth": {"drive": {"viscous": {"a": 0.5}}}}
    for name, family in ((name, family) for name in USUAL for family in FORM_FAMILIES):
        effect, copy = truth_entry(name, family), truth_entry(name, family)
        with_contract_values(effect, case)
        values = {
            key: parameter["value"]
            for key, parameter in {**effect["parameters"], **effect["details"]}.items()
        }
        assert effect == copy and values == USUAL[name]


@pytest.mark.parametrize("name", sorted(EFFECT_TYPES))
def test_conversions_concern_parameters_of_the_effect_only(name):
    effect_type, values = (
        EFFECT_TYPES[name],
        {q.name: q.default_value(60.0, 3.0) for q in EFFECT_TYPES[name].parameters},
    )
    for family, conversion in effect_type.conversions.items():
        other = conversion(values)
        assert family in effect_type.forms and set(other) <= {
            q.name for q in effect_type.parameters if q.in_contract
        }
        assert all(np.isfinite(number) and number != values[key] for key, number in other.items())


@pytest.mark.parametrize("family", FORM_FAMILIES)
def test_asymmetric_viscous_friction_includes_the_base_model(family):
    assert contract_values("asymmetric_viscous", family) == pytest.approx(
        {"positive": 0.7, "negative": 0.2}
    )
    assert not contract_values("torque_saturation", family)


def answer_with(name: str, **numbers: float) -> dict[str, object]:
    parameters = {
        key: {"value": value, "std": 0.1 * value, "unit": ""} for key, value in numbers.items()
    }
    finding = {
        "effect": name,
        "joint": "a",
        "probability": 0.9,
        "equivalents": [],
        "parameters": parameters,
    }
    return {"seconds": 1.0, "answer": {"findings": [finding], "unknown": [], "joints": {}}}


def case_with(effect: Mapping[str, object]) -> dict[str, object]:
    return {
        "spec": {"category": "single", "names": (effect["effect"],)},
        "joints": ["a"],
        "effects": [{"unique_severity": 5.0, **effect}],
        "held_out": {"before": [3.0], "oracle": [1.0], "noise": [1.0]},
    }


def test_parameter_errors_compare_with_the_contract_values():
    expected = contract_values("stribeck", "scored")["velocity"]
    (error,) = compare_answer(
        case_with(truth_entry("stribeck", "scored")), answer_with("stribeck", velocity=expected)
    ).errors
    assert error == ("stribeck.velocity", pytest.approx(0.0), True)


def test_parameters_of_equivalent_effects_are_not_compared():
    drag = {
        **truth_entry("delay", "scored"),
        "effect": "drag",
        "parameters": {"coefficient": {"value": 2.0, "unit": "N m s²/rad²"}},
    }
    other = compare_answer(
        case_with(drag), answer_with("nonlinear_viscous", coefficient=2.0, exponent=1.9)
    )
    assert other.rights == (True,) and not other.errors
    assert compare_answer(case_with(drag), answer_with("drag", coefficient=2.0)).errors

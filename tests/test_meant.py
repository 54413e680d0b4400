"""What a key's parameters mean in the contract's words, each measured on the law itself."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

pytest.importorskip("mujoco")

from concealed_trial.score import mark, whole

from excite.simulator.actuator import Drive
from excite.simulator.effect_instance import Effect
from excite.simulator.effects import FAMILIES, KINDS
from excite.simulator.effects.effect_type import Site, sign
from excite.simulator.physical_effect import Instant, Law

Array = np.ndarray
ONE = np.ones(1)
DRIVE = Drive(
    inertia=0.4 * ONE, viscous=0.5 * ONE, coulomb=1.5 * ONE, width=4e-3 * ONE, offset=0.2 * ONE
)
SITE = Site(1, 0, 0, 60.0 * ONE, 3.0 * ONE, DRIVE, "a", "link")
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


def law(name: str, family: str, **own: float) -> Law:
    return KINDS[name].forms[family](SITE, {**USUAL[name], **own})


def entry(name: str, family: str, **own: float) -> dict[str, object]:
    """As a key has it."""
    return {**Effect(name, "a", family, {**USUAL[name], **own}).document(), "severity": 5.0}


def meant(name: str, family: str, **own: float) -> Mapping[str, float]:
    """What an answer is compared with."""
    case = {"truth": {"drive": {"viscous": {"a": 0.5}}}}
    return {
        key: one["value"]
        for key, one in whole(entry(name, family, **own), case)["parameters"].items()
    }


def torque(
    it: Law, q: Array | float = 0.0, v: Array | float = 1.0, t: Array | float = 0.0
) -> Array:
    """At the joint, without acceleration or load."""
    t, q, v = np.broadcast_arrays(t, q, v)
    out = it.torque(
        Instant(t, q[..., None], v[..., None], 0.0 * q[..., None], 0.0 * q[..., None]), np.empty(0)
    )
    assert out is not None
    return np.asarray(out[..., 0])


def wave(values: Array, angle: Array) -> float:
    """Amplitude of one wave over whole turns."""
    return float(2.0 * np.abs(np.mean(values * np.exp(1j * angle))))


# -- by the laws ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("velocity", [0.02, 0.3])
def test_stribeck_friction_has_fallen_to_1_over_e_at_its_velocity(family, velocity):
    told = meant("stribeck", family, velocity=velocity)
    v = np.array([1e-7, told["velocity"]])
    most, there = torque(law("stribeck", family, velocity=velocity), v=v) / sign(v)
    assert there / most == pytest.approx(np.exp(-1.0))
    assert most == pytest.approx(told["amplitude"])


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("phase", [0.0, 0.6, -2.5, np.pi])
def test_position_friction_varies_by_its_amplitude_to_either_side(family, phase):
    found = torque(
        law("position_friction", family, phase=phase), q=np.linspace(0.0, np.pi, 20001)
    ) / sign(1.0)
    assert 0.5 * np.ptp(found) == pytest.approx(
        meant("position_friction", family, phase=phase)["amplitude"], rel=1e-4
    )


@pytest.mark.parametrize("family", FAMILIES)
def test_a_ripple_has_its_amplitude_at_its_order(family):
    # a hundred turns: as many of the second mesh are whole
    q, told = (
        np.linspace(0.0, 200.0 * np.pi, 400000, endpoint=False),
        meant("torque_ripple", family),
    )
    assert wave(torque(law("torque_ripple", family), q=q), told["order"] * q) == pytest.approx(
        told["amplitude"]
    )


@pytest.mark.parametrize("family", FAMILIES)
def test_an_encoder_errs_by_its_amplitude_at_its_order(family):
    q, told = np.linspace(0.0, 2.0 * np.pi, 20000, endpoint=False), meant("encoder_error", family)
    assert wave(
        law("encoder_error", family).seen(q[:, None])[:, 0] - q, told["order"] * q
    ) == pytest.approx(told["amplitude"])


def test_friction_that_warms_is_there_but_for_1_over_e_after_its_time_constant():
    told = meant("thermal_drift", "tuning")
    there, end = torque(law("thermal_drift", "tuning"), t=np.array([told["time_constant"], 1e6]))
    assert there / end == pytest.approx(1.0 - np.exp(-1.0))
    assert end / (DRIVE.friction(ONE) - DRIVE.offset)[0] == pytest.approx(told["change"])


def test_friction_that_heats_itself_has_no_one_change():
    """The law's own is that of viscous friction at a steady speed; at crawl it is half of it, at rest nothing warms at all."""
    it, warm = law("thermal_drift", "scored"), np.ones(1)
    share = [
        it.torque(Instant(0.0, 0.0 * ONE, v * ONE, 0.0 * ONE, 0.0 * ONE), warm)[0] / (0.5 * v + 1.5)
        for v in (0.1, 1.2, 1e5)
    ]
    assert share == pytest.approx([-0.206, -0.257, -0.4], abs=1e-3)
    assert set(meant("thermal_drift", "scored")) == {"time_constant"}


# -- where the law's number is the contract's already --------------------------------------------------------------


@pytest.mark.parametrize("family", FAMILIES)
def test_hysteresis_is_as_stiff_at_rest_and_as_large_at_last_as_it_says(family):
    it, told = law("hysteresis", family), meant("hysteresis", family)
    steps = np.array([1e-8, *np.full(2000, 1e-4)])
    z, found = np.zeros(it.memory), []
    for step in steps:
        x = Instant(np.zeros(()), np.zeros(1), np.array([step]), np.zeros(1), np.zeros(1))
        z = it.advance(x, z, 1.0)
        found.append(float(it.torque(x, z)[0]))
    assert found[0] / steps[0] == pytest.approx(told["stiffness"], rel=1e-3)
    assert found[-1] == pytest.approx(told["amplitude"], rel=1e-6)


@pytest.mark.parametrize("family", FAMILIES)
def test_a_delay_shifts_a_ramp_by_itself(family):
    t = np.linspace(0.0, 1.0, 5)
    np.testing.assert_allclose(
        law("delay", family).told(lambda at: at[:, None], t)[:, 0],
        t - meant("delay", family)["seconds"],
    )


# -- by the key ----------------------------------------------------------------------------------------------------


def test_the_key_states_what_remakes_the_law():
    case = {"truth": {"drive": {"viscous": {"a": 0.5}}}}
    for name, family in ((name, family) for name in USUAL for family in FAMILIES):
        own, copy = entry(name, family), entry(name, family)
        whole(own, case)
        values = {key: one["value"] for key, one in {**own["parameters"], **own["details"]}.items()}
        assert own == copy and values == USUAL[name]


@pytest.mark.parametrize("name", sorted(KINDS))
def test_only_what_a_kind_has_is_restated(name):
    kind, values = KINDS[name], {q.name: q.middle(60.0, 3.0) for q in KINDS[name].quantities}
    for family, meaning in kind.meant.items():
        other = meaning(values)
        assert family in kind.forms and set(other) <= {q.name for q in kind.quantities if q.stated}
        assert all(np.isfinite(number) and number != values[key] for key, number in other.items())


@pytest.mark.parametrize("family", FAMILIES)
def test_viscous_friction_by_direction_is_all_of_it_and_a_loss_elsewhere_is_none(family):
    assert meant("asymmetric_viscous", family) == pytest.approx({"positive": 0.7, "negative": 0.2})
    assert not meant("torque_saturation", family)


def answered(name: str, **numbers: float) -> dict[str, object]:
    found = {
        key: {"value": value, "std": 0.1 * value, "unit": ""} for key, value in numbers.items()
    }
    one = {"effect": name, "joint": "a", "probability": 0.9, "equivalents": [], "parameters": found}
    return {"seconds": 1.0, "answer": {"findings": [one], "unknown": [], "joints": {}}}


def key_of(effect: Mapping[str, object]) -> dict[str, object]:
    spec = {"sort": "single", "trap": "none", "trusted": False}
    return {
        "spec": spec,
        "joints": ["a"],
        "effects": [effect],
        "held_out": {"before": [3.0], "oracle": [1.0], "noise": [1.0]},
    }


def test_a_mark_compares_with_what_is_meant():
    told = meant("stribeck", "scored")["velocity"]
    (error,) = mark(key_of(entry("stribeck", "scored")), answered("stribeck", velocity=told)).errors
    assert error == ("stribeck.velocity", pytest.approx(0.0), True)


def test_coefficients_of_two_laws_are_not_compared():
    drag = {
        **entry("delay", "scored"),
        "effect": "drag",
        "parameters": {"coefficient": {"value": 2.0, "unit": "N m s²/rad²"}},
    }
    other = mark(key_of(drag), answered("nonlinear_viscous", coefficient=2.0, exponent=1.9))
    assert other.joint and not other.errors
    assert mark(key_of(drag), answered("drag", coefficient=2.0)).errors

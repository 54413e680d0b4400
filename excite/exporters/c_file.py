"""C file of an identified robot: inverse dynamics, friction feed-forward and gravity torque.

The expressions are those of `casadi_model` and `friction_runtime`; CasADi writes them as C99
without dependencies. Wrappers with plain arrays follow, so that a controller needs none of CasADi's
calling convention. Presliding hysteresis, and dry friction that builds up with it, has a state: a
struct that the caller holds and a step function advances. Nothing is allocated, and all functions
are reentrant.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from .._system.comments import c_comment
from ..designer import casadi_model
from ..effects import friction_runtime
from ..effects.friction_runtime import JointMotion, MaxwellSlipBank, Term
from .python_friction import friction_table, is_term
from .simulator_model import Held, SimulatorModel

HOLDS: frozenset[Held] = frozenset(Held) - {Held.ACTUATOR_DELAY}
"""Quantities that the file computes."""
FUNCTIONS = {
    "inverse_dynamics": ("q", "dq", "ddq"),
    "friction": ("q", "dq", "load"),
    "gravity": ("q",),
    "bank_level": ("q", "dq", "load"),
}
"""Arguments of each function, all of shape (n,)."""
RESULTS = {"bank_level": "level[EXCITE_BANKS]"}
"""Result of a function whose result is not the torque of the joints."""
TEXTS = {
    "inverse_dynamics": "torque of links, rotors, friction and offset [N m or N]",
    "friction": "friction, offset and springs; load: torque of links (inverse dynamics without "
    "rotors) [N m or N]",
    "gravity": "static torque of links [N m or N]",
    "bank_level": "factor of the force of each Maxwell-slip bank",
}
"""Result of each function and its unit."""


def torque_functions(model: SimulatorModel) -> list[ca.Function]:
    """Return the functions of `FUNCTIONS`.

    Args:
        model: The identified robot.
    """
    robot, n = model.model.robot, model.model.robot.n
    phi = ca.SX(model.psi[: 10 * len(robot.links)])
    x = {name: ca.SX.sym(name, n) for name in ("q", "dq", "ddq", "load")}
    still = ca.SX.zeros(n)
    rigid = casadi_model.link_torque(robot, x["q"], x["dq"], x["ddq"], phi)
    rotors = ca.SX(model.torques.rotor_inertia) * x["ddq"]
    terms, widths = _terms(model)
    outputs = {
        "inverse_dynamics": rigid + rotors + _friction(terms, widths, {**x, "load": rigid}),
        "friction": _friction(terms, widths, {**x, "ddq": still}),
        "gravity": casadi_model.link_torque(robot, x["q"], still, still, phi),
    }
    levels = [
        ca.SX(1.0)
        if term.effect in friction_runtime.WITH_MEMORY
        else _parts(term, {**x, "ddq": still}, widths)[1]
        for term in terms
        if friction_runtime.has_state(term)
    ]
    if levels:
        outputs["bank_level"] = ca.vertcat(*levels)
    return [
        ca.Function(
            name, [x[key] for key in FUNCTIONS[name]], [ca.densify(out)], FUNCTIONS[name], ["tau"]
        )
        for name, out in outputs.items()
    ]


def _terms(model: SimulatorModel) -> tuple[list[Term], list[float]]:
    """Terms of the friction, and the widths of the sign function of each joint."""
    table = friction_table(model)
    return [Term(**entry) for entry in table["terms"]], table["widths"]


def _friction(terms: Sequence[Term], widths: Sequence[float], x: dict[str, ca.SX]) -> ca.SX:
    """Torque of all terms without memory, as an expression. Shape (n,)."""
    out = ca.SX.zeros(len(widths))
    for term in terms:
        if term.effect not in friction_runtime.WITH_MEMORY:
            out[term.joint] += _term_torque(term, x, widths)
    return out


def _term_torque(term: Term, x: dict[str, ca.SX], widths: Sequence[float]) -> ca.SX:
    """Torque of a term at its joint, its dry part at once, as an expression."""
    smooth, dry = _parts(term, x, widths)
    return smooth + dry * ca.tanh(x["dq"][term.joint] / float(widths[term.joint]))


def _parts(term: Term, x: dict[str, ca.SX], widths: Sequence[float]) -> tuple[ca.SX, ca.SX]:
    """Smooth part of a term's torque and factor of the sign, as expressions."""
    j, other = term.joint, max(term.other, 0)
    motion = JointMotion(
        x["q"][j],
        x["dq"][j],
        x["ddq"][j],
        x["load"][j],
        x["dq"][other],
        x["ddq"][other],
        float(widths[j]),
    )
    smooth, dry = friction_runtime.stateless(term, motion, ca)
    return ca.SX(smooth), ca.SX(dry)


def c_text(model: SimulatorModel) -> str:
    """Return the C file of an identified robot.

    Args:
        model: The identified robot.
    """
    functions = torque_functions(model)
    generator = ca.CodeGenerator("excite_model.c", {"with_header": False, "casadi_int": "int"})
    for function in functions:
        generator.add(function)
    lines = model.header("C", HOLDS, is_term)
    joints = [f" {j}: {name}" for j, name in enumerate(model.joints)]
    lines += ["joints, in the order of all arrays:", *joints]
    n = len(model.joints)
    terms, widths = _terms(model)
    banks = [
        (term.joint, MaxwellSlipBank(term)) for term in terms if friction_runtime.has_state(term)
    ]
    wrappers = [f"#define EXCITE_JOINTS {n}"]
    if banks:
        wrappers[0] += f"\n#define EXCITE_BANKS {len(banks)}"
    wrappers += [_wrapper(function, _work_sizes(function)) for function in functions]
    if banks:
        lines += ["torque = excite_inverse_dynamics + excite_hysteresis, which has a state"]
        wrappers.append(_hysteresis(banks, widths))
    return f"{c_comment(lines)}\n{generator.dump()}\n" + "\n\n".join(wrappers) + "\n"


def _work_sizes(function: ca.Function) -> tuple[int, int, int, int]:
    """Lengths of the arrays of arguments, results, integers and numbers of a generated function."""
    return function.sz_arg(), function.sz_res(), function.sz_iw(), function.sz_w()


def _wrapper(function: ca.Function, sizes: Sequence[int]) -> str:
    """A C function with plain arrays for a generated function."""
    name = function.name()
    keys = FUNCTIONS[name]
    arguments = ", ".join(f"const double {key}[EXCITE_JOINTS]" for key in keys)
    count, results, integers, numbers = (max(1, int(size)) for size in sizes)
    result = RESULTS.get(name, "tau[EXCITE_JOINTS]")
    stored = "\n".join(f"  arg[{i}] = {key};" for i, key in enumerate(keys))
    return (
        f"/* {TEXTS[name]} */\n"
        f"void excite_{name}({arguments}, double {result}) {{\n"
        f"  const double* arg[{count}];\n  double* res[{results}];\n"
        f"  int iw[{integers}];\n  double w[{numbers}];\n"
        f"{stored}\n  res[0] = {result.partition('[')[0]};\n  {name}(arg, res, iw, w, 0);\n}}"
    )


def _hysteresis(banks: Sequence[tuple[int, MaxwellSlipBank]], widths: Sequence[float]) -> str:
    """Return the C code of presliding hysteresis: tables, state, reset and step.

    It is that of `MaxwellSlipBank.advance`, less the part of Coulomb friction that the slipping
    elements replace, as `Friction.parts` has it.
    """
    elements = friction_runtime.ELEMENTS
    unequal = np.zeros((len(banks), elements))
    for row, (_, bank) in zip(unequal, banks, strict=True):
        row[friction_runtime.UNEQUAL_ELEMENTS] = bank.unequal
    values = {
        "distance": np.concatenate([bank.distances for _, bank in banks]),
        "strength": np.concatenate([bank.strengths for _, bank in banks]),
        "unequal": unequal.ravel(),
        "damping": np.concatenate([bank.damping for _, bank in banks]),
        "width": np.array([widths[joint] for joint, _ in banks]),
    }
    tables = {
        "distance": "[EXCITE_BANKS * EXCITE_ELEMENTS] = {0}; /* of slip [rad or m] */",
        "strength": "[EXCITE_BANKS * EXCITE_ELEMENTS] = {0}; /* of an element that slips */",
        "unequal": "[EXCITE_BANKS * EXCITE_ELEMENTS] = {0}; /* factor of |z| - 1 */",
        "damping": "[EXCITE_BANKS * EXCITE_ELEMENTS] = {0}; /* of an element that sticks */",
        "width": "[EXCITE_BANKS] = {0}; /* of the sign function [rad/s or m/s] */",
    }
    joints = ", ".join(str(joint) for joint, _ in banks)
    lines = [
        f"#define EXCITE_ELEMENTS {elements}",
        f"static const int excite_bank_joint[EXCITE_BANKS] = {{{joints}}};",
    ]
    for name, text in tables.items():
        numbers = "{" + ", ".join(repr(value) for value in values[name].tolist()) + "}"
        lines.append(f"static const double excite_bank_{name}{text.format(numbers)}")
    return "\n".join(lines) + _HYSTERESIS


_HYSTERESIS = """

/* State of presliding hysteresis: Maxwell-slip elements of each joint that has them. Begin with
   excite_hysteresis_reset at the present position. */
typedef struct {
  double last[EXCITE_BANKS];                /* position of the last step [rad or m] */
  double z[EXCITE_BANKS][EXCITE_ELEMENTS];  /* deflection over the slip distance, -1 to 1 */
} excite_hysteresis_state;

/* Relax all elements at a position. */
void excite_hysteresis_reset(excite_hysteresis_state* state, const double q[EXCITE_JOINTS]) {
  int i, k;
  for (i = 0; i < EXCITE_BANKS; ++i) {
    state->last[i] = q[excite_bank_joint[i]];
    for (k = 0; k < EXCITE_ELEMENTS; ++k) state->z[i][k] = 0.0;
  }
}

/* Advance to a position; load: torque of links, as for excite_friction; tau: torque to add to that
   of excite_inverse_dynamics or excite_friction [N m or N]. The state depends on the path, not on
   the time between two steps. */
void excite_hysteresis(excite_hysteresis_state* state, const double q[EXCITE_JOINTS],
                       const double dq[EXCITE_JOINTS], const double load[EXCITE_JOINTS],
                       double tau[EXCITE_JOINTS]) {
  int i, k;
  double level[EXCITE_BANKS];
  excite_bank_level(q, dq, load, level);
  for (i = 0; i < EXCITE_JOINTS; ++i) tau[i] = 0.0;
  for (i = 0; i < EXCITE_BANKS; ++i) {
    const int joint = excite_bank_joint[i];
    const double* distance = excite_bank_distance + i * EXCITE_ELEMENTS;
    const double* strength = excite_bank_strength + i * EXCITE_ELEMENTS;
    const double* unequal = excite_bank_unequal + i * EXCITE_ELEMENTS;
    const double* damping = excite_bank_damping + i * EXCITE_ELEMENTS;
    const double moved = q[joint] - state->last[i], sign = tanh(dq[joint] / excite_bank_width[i]);
    state->last[i] = q[joint];
    for (k = 0; k < EXCITE_ELEMENTS; ++k) {
      double z = state->z[i][k] + moved / distance[k];
      z = z > 1.0 ? 1.0 : z < -1.0 ? -1.0 : z;
      state->z[i][k] = z;
      tau[joint] += level[i] * strength[k] * (z - sign) + unequal[k] * (fabs(z) - 1.0);
      if (fabs(z) < 1.0) tau[joint] += damping[k] * dq[joint];
    }
  }
}"""
"""C code of the state of presliding hysteresis, which follows the tables of the robot."""

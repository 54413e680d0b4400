"""C file of an identified robot: inverse dynamics, friction feed-forward and gravity torque.

The expressions are those of `casadi_model` and `friction_runtime`; CasADi writes them as C99
without dependencies. Wrappers with plain arrays follow, so that a controller needs none of CasADi's
calling convention. They allocate nothing and are reentrant.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from ..designer import casadi_model
from ..schemas.effects import EffectDocument
from . import friction_runtime
from .friction_runtime import JointMotion, Term
from .python_friction import friction_table, is_term
from .simulator_model import Held, SimulatorModel

HOLDS = frozenset(Held) - {Held.ACTUATOR_DELAY}
"""Quantities that the file computes."""
FUNCTIONS = {
    "inverse_dynamics": ("q", "dq", "ddq"),
    "friction": ("q", "dq", "load"),
    "gravity": ("q",),
}
"""Arguments of each function, all of shape (n,)."""
TEXTS = {
    "inverse_dynamics": "torque of links, rotors, friction and offset [N m or N]",
    "friction": "friction, offset and springs; load: torque of links (inverse dynamics without "
    "rotors) [N m or N]",
    "gravity": "static torque of links [N m or N]",
}
"""Torque that each function returns, with its unit."""


def is_computed(effect: EffectDocument) -> bool:
    """Return whether the C file computes an effect: a torque of one joint without memory."""
    return is_term(effect) and effect.effect not in friction_runtime.WITH_MEMORY


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
    outputs = {
        "inverse_dynamics": rigid + rotors + _friction(model, {**x, "load": rigid}),
        "friction": _friction(model, {**x, "ddq": still}),
        "gravity": casadi_model.link_torque(robot, x["q"], still, still, phi),
    }
    return [
        ca.Function(name, [x[key] for key in keys], [ca.densify(outputs[name])], keys, ["tau"])
        for name, keys in FUNCTIONS.items()
    ]


def _friction(model: SimulatorModel, x: dict[str, ca.SX]) -> ca.SX:
    """Torque of all terms without memory, as an expression. Shape (n,)."""
    table = friction_table(model)
    out = ca.SX.zeros(model.model.robot.n)
    for entry in table["terms"]:
        term = Term(**entry)
        if term.effect not in friction_runtime.WITH_MEMORY:
            out[term.joint] += _term_torque(term, x, table["widths"])
    return out


def _term_torque(term: Term, x: dict[str, ca.SX], widths: Sequence[float]) -> ca.SX:
    """Torque of a term at its joint, as an expression."""
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
    return smooth + dry * ca.tanh(motion.dq / motion.width)


def c_text(model: SimulatorModel) -> str:
    """Return the C file of an identified robot.

    Args:
        model: The identified robot.
    """
    functions = torque_functions(model)
    generator = ca.CodeGenerator("excite_model.c", {"with_header": False, "casadi_int": "int"})
    for function in functions:
        generator.add(function)
    lines = model.header("C", HOLDS, is_computed)
    joints = [f" {j}: {name}" for j, name in enumerate(model.joints)]
    lines += ["joints, in the order of all arrays:", *joints]
    n = len(model.joints)
    wrappers = [f"#define EXCITE_JOINTS {n}"]
    wrappers += [_wrapper(function, _work_sizes(function)) for function in functions]
    comment = "\n".join(f" * {line}" for line in lines)
    return f"/*\n{comment}\n */\n{generator.dump()}\n" + "\n\n".join(wrappers) + "\n"


def _work_sizes(function: ca.Function) -> tuple[int, int, int, int]:
    """Lengths of the arrays of arguments, results, integers and numbers of a generated function."""
    return function.sz_arg(), function.sz_res(), function.sz_iw(), function.sz_w()


def _wrapper(function: ca.Function, sizes: Sequence[int]) -> str:
    """A C function with plain arrays for a generated function."""
    name = function.name()
    keys = FUNCTIONS[name]
    arguments = ", ".join(f"const double {key}[EXCITE_JOINTS]" for key in keys)
    count, results, integers, numbers = (max(1, int(size)) for size in sizes)
    stored = "\n".join(f"  arg[{i}] = {key};" for i, key in enumerate(keys))
    return (
        f"/* {TEXTS[name]} */\n"
        f"void excite_{name}({arguments}, double tau[EXCITE_JOINTS]) {{\n"
        f"  const double* arg[{count}];\n  double* res[{results}];\n"
        f"  int iw[{integers}];\n  double w[{numbers}];\n"
        f"{stored}\n  res[0] = tau;\n  {name}(arg, res, iw, w, 0);\n}}"
    )

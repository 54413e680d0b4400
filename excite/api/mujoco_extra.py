"""The optional dependency MuJoCo, the extra `sim`."""

from __future__ import annotations

import importlib.util

from ..errors import UnusableInput


def require_mujoco() -> None:
    """Check that MuJoCo is installed.

    Raises:
        UnusableInput: It is not.
    """
    if importlib.util.find_spec("mujoco") is None:
        raise UnusableInput(
            "MuJoCo is not installed; install the extra: .venv/bin/pip install -e '.[sim]'"
        )

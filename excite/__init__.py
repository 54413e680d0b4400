"""Optimal excitation trajectories for robot identification.

The functions below do what the commands of the same names do; the packages behind them offer more
control. They are imported on first use, so that `import excite` alone is quick. Type checkers see
them through the import of `excite.api`; the list `__all__` names them at run time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .api import *
else:

    def __getattr__(name: str) -> Any:
        """Import the public interface when one of its names is first used."""
        if name in __all__:
            from . import api

            return getattr(api, name)
        raise AttributeError(f"module 'excite' has no attribute '{name}'")


__version__ = "0.1.0"
__all__ = [
    "DesignResult",
    "DiagnosisResult",
    "ExportedModel",
    "FloatingIdentificationResult",
    "IdentificationResult",
    "PayloadResult",
    "PredictedWrench",
    "ReplayResult",
    "ServoIdentificationResult",
    "SimulatedFloatingRecording",
    "SimulatedRecording",
    "StaticDesignResult",
    "SupportDesignResult",
    "VerificationResult",
    "design",
    "design_static",
    "design_support",
    "diagnose",
    "export",
    "export_model",
    "identify",
    "identify_floating",
    "identify_payload",
    "identify_servo",
    "load_floating_robot",
    "load_robot",
    "predict",
    "read_floating_recording",
    "read_recording",
    "replay",
    "simulate",
    "simulate_floating",
    "simulate_standing",
    "verify",
]


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])

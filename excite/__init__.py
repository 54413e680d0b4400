"""Optimal excitation trajectories for robot identification.

The functions below do what the commands of the same names do; the packages behind them are for
those who want more control.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .api import (
        DesignResult,
        DiagnosisResult,
        IdentificationResult,
        SimulatedRecording,
        VerificationResult,
        design,
        diagnose,
        export,
        identify,
        load_robot,
        predict,
        read_recording,
        simulate,
        verify,
    )

__version__ = "0.1.0"
__all__ = [
    "DesignResult",
    "DiagnosisResult",
    "IdentificationResult",
    "SimulatedRecording",
    "VerificationResult",
    "design",
    "diagnose",
    "export",
    "identify",
    "load_robot",
    "predict",
    "read_recording",
    "simulate",
    "verify",
]


def __getattr__(name: str) -> Any:
    """Import the public interface when it is first asked for: `import excite` alone stays light."""
    if name in __all__:
        from . import api

        return getattr(api, name)
    raise AttributeError(f"module 'excite' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])

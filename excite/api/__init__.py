"""Public interface: the functions that the commands call, for use in Python.

Every function takes paths as `str` or `Path` and robots as a path, a built-in name or a loaded `Robot`, and returns a result with
`save(folder)` and `report(path)`.
"""

from .design import DesignResult, design
from .diagnose import DiagnosisResult, diagnose
from .identify import IdentificationResult, identify, predict, read_recording
from .robot import load_robot
from .simulate import SimulatedRecording, simulate
from .verify import VerificationResult, export, verify

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

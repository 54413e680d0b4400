"""Public interface: the functions that the commands call, for use in Python.

Every function takes paths as `str` or `Path` and robots as a path, a built-in name or a loaded
`Robot`, and returns a result with
`save(folder)` and `report(path)`.
"""

from .design_result import DesignResult, design
from .diagnosis_result import DiagnosisResult, diagnose
from .identification_result import IdentificationResult, identify, predict, read_recording
from .robots import load_robot
from .simulated_recording import SimulatedRecording, simulate
from .verification_result import VerificationResult, export, verify

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

"""Public interface: the functions behind the commands, for use in Python.

Every function takes paths as `str` or `Path` and robots as a path, a built-in name or a loaded
`Robot`, and returns a result with `save` and `report`. The names below are those of `excite`;
`excite/__init__.py` imports this package when one of them is first used.
"""

from .design_result import DesignResult as DesignResult
from .design_result import design as design
from .diagnosis_result import DiagnosisResult as DiagnosisResult
from .diagnosis_result import diagnose as diagnose
from .floating_result import FloatingIdentificationResult as FloatingIdentificationResult
from .floating_result import PredictedWrench as PredictedWrench
from .floating_result import identify_floating as identify_floating
from .floating_result import load_floating_robot as load_floating_robot
from .floating_result import read_floating_recording as read_floating_recording
from .floating_simulation import SimulatedFloatingRecording as SimulatedFloatingRecording
from .floating_simulation import simulate_floating as simulate_floating
from .identification_result import IdentificationResult as IdentificationResult
from .identification_result import identify as identify
from .identification_result import predict as predict
from .identification_result import read_recording as read_recording
from .model_export import ExportedModel as ExportedModel
from .model_export import export_model as export_model
from .payload_result import PayloadResult as PayloadResult
from .payload_result import identify_payload as identify_payload
from .replay_result import ReplayResult as ReplayResult
from .replay_result import replay as replay
from .robots import load_robot as load_robot
from .servo_identification_result import ServoIdentificationResult as ServoIdentificationResult
from .servo_identification_result import identify_servo as identify_servo
from .simulated_recording import SimulatedRecording as SimulatedRecording
from .simulated_recording import simulate as simulate
from .standing_simulation import simulate_standing as simulate_standing
from .static_design_result import StaticDesignResult as StaticDesignResult
from .static_design_result import design_static as design_static
from .support_design_result import SupportDesignResult as SupportDesignResult
from .support_design_result import design_support as design_support
from .verification_result import VerificationResult as VerificationResult
from .verification_result import export as export
from .verification_result import verify as verify

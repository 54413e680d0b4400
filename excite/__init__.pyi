from .api import DesignResult as DesignResult
from .api import DiagnosisResult as DiagnosisResult
from .api import ExportedModel as ExportedModel
from .api import FloatingIdentificationResult as FloatingIdentificationResult
from .api import IdentificationResult as IdentificationResult
from .api import PayloadResult as PayloadResult
from .api import PredictedWrench as PredictedWrench
from .api import ReplayResult as ReplayResult
from .api import ServoIdentificationResult as ServoIdentificationResult
from .api import SimulatedFloatingRecording as SimulatedFloatingRecording
from .api import SimulatedRecording as SimulatedRecording
from .api import StaticDesignResult as StaticDesignResult
from .api import SupportDesignResult as SupportDesignResult
from .api import VerificationResult as VerificationResult
from .api import design as design
from .api import design_static as design_static
from .api import design_support as design_support
from .api import diagnose as diagnose
from .api import export as export
from .api import export_model as export_model
from .api import identify as identify
from .api import identify_floating as identify_floating
from .api import identify_payload as identify_payload
from .api import identify_servo as identify_servo
from .api import load_floating_robot as load_floating_robot
from .api import load_robot as load_robot
from .api import predict as predict
from .api import read_floating_recording as read_floating_recording
from .api import read_recording as read_recording
from .api import replay as replay
from .api import simulate as simulate
from .api import simulate_floating as simulate_floating
from .api import simulate_standing as simulate_standing
from .api import verify as verify

__version__: str
__all__: list[str]

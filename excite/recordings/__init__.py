"""Recordings of a robot's motion: read from what people have, checked, repaired by stated rules."""

from .block import QUANTITIES
from .read import read, stream
from .recording import Recording, refuse_same
from .remark import Kind, Remark
from .sidecar import Sidecar

__all__ = ["QUANTITIES", "Kind", "Recording", "Remark", "Sidecar", "read", "refuse_same", "stream"]

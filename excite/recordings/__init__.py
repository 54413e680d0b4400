"""Recordings of a robot's motion: read from common formats, checked, and repaired by stated
rules."""

from .block import QUANTITIES
from .read import read, stream
from .recording import Recording, require_distinct
from .remark import Remark, RemarkKind
from .sidecar import Sidecar

__all__ = [
    "QUANTITIES",
    "Recording",
    "Remark",
    "RemarkKind",
    "Sidecar",
    "read",
    "require_distinct",
    "stream",
]

"""One study of one measurement."""

from estimation.study.arm import Arm
from estimation.study.channels import StudyChannel
from estimation.study.comparison import Comparison
from estimation.study.estimates import ChannelEstimates
from estimation.study.patterns import Part
from estimation.study.results import Change, ChannelResult, Stage, StudyDiagnosis
from estimation.study.revisions import Revision, Revisions
from estimation.study.study import ModelStudy

__all__ = [
    "Arm",
    "Change",
    "ChannelEstimates",
    "ChannelResult",
    "Comparison",
    "ModelStudy",
    "Part",
    "Revision",
    "Revisions",
    "Stage",
    "StudyChannel",
    "StudyDiagnosis",
]

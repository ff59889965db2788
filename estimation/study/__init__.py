"""Study of one measurement: data, models, fits, comparison and diagnosis."""

from palpate.estimation.base_model import Arm
from palpate.estimation.study.channels import StudyChannel
from palpate.estimation.study.comparison import Comparison, ErrorPart
from palpate.estimation.study.estimates import ChannelEstimates
from palpate.estimation.study.results import ChannelResult, ModelStage, RevisionChange, StudyDiagnosis
from palpate.estimation.study.revisions import Revision, Revisions
from palpate.estimation.study.study import ModelStudy

__all__ = [
    "Arm",
    "ChannelEstimates",
    "ChannelResult",
    "Comparison",
    "ErrorPart",
    "ModelStage",
    "ModelStudy",
    "Revision",
    "RevisionChange",
    "Revisions",
    "StudyChannel",
    "StudyDiagnosis",
]

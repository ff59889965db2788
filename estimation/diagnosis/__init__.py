"""Diagnosis of the effects that a model lacks, with evidence."""

from palpate.estimation.diagnosis.diagnose import diagnose
from palpate.estimation.diagnosis.result import ChannelDiagnosis, Diagnosis, Verdict

__all__ = ["ChannelDiagnosis", "Diagnosis", "Verdict", "diagnose"]

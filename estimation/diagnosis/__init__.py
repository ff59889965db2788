"""What is missing in a model, with evidence."""

from estimation.diagnosis.diagnose import diagnose
from estimation.diagnosis.result import ChannelDiagnosis, Diagnosis, Verdict

__all__ = ["ChannelDiagnosis", "Diagnosis", "Verdict", "diagnose"]

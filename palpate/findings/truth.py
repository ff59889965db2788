"""As `palpate.findings`."""

from palpate.truth import SURFACE, true_parameters

__all__ = ["SURFACE", "true_parameters"]

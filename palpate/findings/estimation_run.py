"""As `palpate.findings`."""

from estimation.study.channels import CONTACT_MODEL as DEFAULT_MODEL
from estimation.study.estimates import BEST, MOST, OFFSET, ChannelEstimates, estimate_with

__all__ = ["BEST", "DEFAULT_MODEL", "MOST", "OFFSET", "ChannelEstimates", "estimate_with"]

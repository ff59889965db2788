"""Every coupling, the rivals first."""

from control.teleop.couplings.direct import DIRECT
from control.teleop.couplings.four_channel import FOUR_CHANNEL
from control.teleop.couplings.model_mediated import model_mediated
from control.teleop.couplings.time_domain import TIME_DOMAIN
from control.teleop.couplings.wave_variables import WAVE_VARIABLES

COUPLINGS = (DIRECT, FOUR_CHANNEL, TIME_DOMAIN, WAVE_VARIABLES, model_mediated())

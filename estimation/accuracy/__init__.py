"""How near estimators come to what is possible, on presses with a known truth."""

from estimation.accuracy.press import Noise, Press
from estimation.accuracy.ransac_map import MapCell, ransac_map
from estimation.accuracy.recovery import Recovery, recover_hunt_crossley

__all__ = ["MapCell", "Noise", "Press", "Recovery", "ransac_map", "recover_hunt_crossley"]

"""What is true in a simulated session: known to the scenario that it keeps, and to nobody else."""

from robot_io.session import Session
from sim_backend.contact_laws import EngineContact, HuntCrossleyLaw, KelvinVoigtLaw
from sim_backend.scenario import Scenario, parse_scenario

SURFACE = "surface"


def scenario_of(session: Session) -> Scenario | None:
    """The simulated world of a session, None where it was no simulation.

    Raises:
        InputError: the session's copy of the scenario is not valid.
    """
    text = session.metadata.scenario
    return parse_scenario(text, f"{session.path}, its scenario") if text else None


def true_parameters(session: Session) -> dict[str, float]:
    """True values by "effect.parameter" as models call them; empty where it was no simulation.

    `SURFACE` is the surface's coordinate along the press direction (downwards) [m].
    """
    scenario = scenario_of(session)
    return {} if scenario is None else truth_of(scenario)


def truth_of(scenario: Scenario) -> dict[str, float]:
    """The same of a simulated world."""
    surface = {SURFACE: -scenario.object.surface_height_m}
    match scenario.object.law:
        case KelvinVoigtLaw() | EngineContact() as law:
            return surface | {"stiffness.k": law.stiffness_n_m, "damping.c": law.damping_n_s_m}
        case HuntCrossleyLaw() as law:
            power = {"k": law.stiffness, "b": law.damping, "n": law.exponent}
            return surface | {f"hunt_crossley.{name}": value for name, value in power.items()}
    return surface

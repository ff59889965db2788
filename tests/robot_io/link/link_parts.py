"""Messages for tests of the line."""

from palpate.robot_io.link.messages import (
    ContactModel,
    EstimatedParameter,
    Intent,
    ObjectEstimate,
    Report,
    Target,
)

DOWN = (0.0, 0.0, -1.0)


def target(number: int = 0, x_m: float = 0.4) -> Target:
    return Target(number, (x_m, 0.0, 0.05), DOWN)


def intent(*targets: Target, **changes) -> Intent:
    return Intent(**{"targets": targets, "cancelled": (), "seen": (), "ended": False} | changes)


def report(**changes) -> Report:
    moment = {
        "phase": 3,
        "target": 1,
        "tip_world_m": (0.4, 0.0, 0.05),
        "speed_m_s": 0.1,
        "direction_world": DOWN,
    }
    rest = {"force_n": 3.5, "targets": (0, 1), "states": (2, 1), "remark": "", "ended": False}
    return Report(**moment | rest | changes)


def estimate(**changes) -> ObjectEstimate:
    values = {
        "revision": 0,
        "target": 0,
        "surface_world_m": (0.4, 0.0, 0.05),
        "direction_world": DOWN,
        "model": (ContactModel("kelvin_voigt", ("stiffness_n_m", "damping_n_s_m"), (500.0, 20.0)),),
        "parameters": (EstimatedParameter("stiffness.k", "N/m", 500.0, 499.0, 501.0),),
        "verdict": "adequate",
        "words": "nothing is missing",
        "rmse_n": 0.02,
        "noise_n": 0.02,
        "runs": 3,
        "measured_s": 12.5,
    }
    return ObjectEstimate(**values | changes)

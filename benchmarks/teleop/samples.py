"""One message of each kind, for trials of the line."""

from robot_io.link import ContactModel, Intent, ObjectEstimate, Parameter, Report, Target

DOWN = (0.0, 0.0, -1.0)
MODEL = ContactModel("kelvin_voigt", ("stiffness_n_m", "damping_n_s_m"), (500.0, 20.0))
INTENT = Intent((Target(0, (0.40, 0.0, 0.05), DOWN), Target(1, (0.42, 0.0, 0.05), DOWN)), (5,), (3,), False)
REPORT = Report(
    4, 0, (0.4, 0.0, 0.05), 0.1, DOWN, 9.8, (0, 1), (1, 0), "target 7 refused: out of reach", False
)
ESTIMATE = ObjectEstimate(
    revision=3,
    target=0,
    surface_world_m=(0.4, 0.0, 0.05),
    direction_world=DOWN,
    model=(MODEL,),
    parameters=(Parameter("stiffness.k", "N/m", 500.0, 499.0, 501.0),),
    verdict="adequate",
    words="nothing is missing",
    rmse_n=0.02,
    noise_n=0.02,
    runs=3,
    measured_s=12.5,
)
MESSAGES = (INTENT, REPORT, ESTIMATE)

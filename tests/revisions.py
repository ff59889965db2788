"""Revisions of a contact's base model unless a test states otherwise."""

from palpate.estimation.study import Revision

SPRING = {
    "stiffness.k": {"value": 1.0, "std_err": None, "unit": "N/m"},
    "damping.c": {"value": 1.0, "std_err": None, "unit": "N s/m"},
}


def revision(number=0, rmse=1.0, **changes) -> Revision:
    told = {"number": number, "parent": None, "channel": "contact", "model": "kelvin_voigt", "added": ""}
    told |= {"effects": [], "user_effects": [], "effort_unit": "N", "rmse": rmse, "noise_floor": 0.5}
    told |= {"parameters": SPRING, "data_sha256": "", "created_utc": "", "software_version": ""}
    return Revision.model_validate(told | changes)

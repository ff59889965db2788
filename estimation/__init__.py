"""Models, effects and estimators of contact and joint channels."""

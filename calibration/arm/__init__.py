"""The arm as a whole: a motion that excites it, and what its torques say of drives, friction and tilt."""

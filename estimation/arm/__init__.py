"""Base parameters of a whole arm, shared by all its joints; see docs/arm-identification.md."""

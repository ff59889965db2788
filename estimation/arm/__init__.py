"""Base parameters of a whole arm, shared by all its joints; see docs/explanation/identification.md."""

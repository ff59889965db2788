"""What is worked out from a session: estimates, comparison, diagnosis, stages of a model."""

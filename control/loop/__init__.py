"""The control loop with its records, its timing and its stop."""

"""Motors in MIT mode (CubeMars AK and kin) on a CAN bus."""

"""Motors in MIT mode (CubeMars AK, Damiao, Robstride and kin) on a CAN bus."""

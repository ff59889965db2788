"""Motors in MIT mode (CubeMars AK, Damiao, Robstride and similar) on a CAN bus."""

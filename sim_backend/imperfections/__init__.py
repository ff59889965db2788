"""Hidden effects, one file for those of a kind, found by name; see `sim_backend.imperfection`."""

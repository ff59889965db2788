"""Hidden effects, one file each, found by name; see `sim_backend.imperfection`."""

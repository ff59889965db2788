"""Hidden effects, in one file for each kind, found by name; see `palpate.sim_backend.imperfection`."""

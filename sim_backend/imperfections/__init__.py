"""Hidden effects, one file for those of a kind, found by name; see `palpate.sim_backend.imperfection`."""

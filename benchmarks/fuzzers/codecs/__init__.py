"""One file per protocol; a new one is found by its `name`."""

"""Plan the next experiment for the arm that made a recording."""

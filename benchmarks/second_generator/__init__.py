"""A numpy world of presses and joints, written only from the vocabulary and textbooks."""

"""A numpy world of presses and joints, written from the vocabulary and textbooks alone."""

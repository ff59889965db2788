"""Results in words and tables, and progress for the person who waits."""

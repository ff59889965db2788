"""The loop: tick after tick, with its records, its timing, and the way out."""

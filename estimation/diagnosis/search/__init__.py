"""Which effects are tried, in which order, and what speaks for them."""

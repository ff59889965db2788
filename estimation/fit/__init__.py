"""Where a model is fitted to a channel, and what it leaves."""

"""What may be said of data and model, and how sure it is."""

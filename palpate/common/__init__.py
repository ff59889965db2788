"""What every command shares: console, files, options, failures."""

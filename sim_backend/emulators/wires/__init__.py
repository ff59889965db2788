"""Which emulated wire stands in for which bus driver; one file each."""

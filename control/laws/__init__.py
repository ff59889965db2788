"""Control laws: pure steps from a measurement to a command."""

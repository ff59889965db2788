"""The hardware abstraction: measurements, commands, interfaces, robot file, clock, guard, session log, drivers."""

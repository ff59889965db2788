"""The hardware abstraction: measurements and commands, interfaces, robot file, clock, guard, session log, drivers."""

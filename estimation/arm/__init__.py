"""Parameters that belong to a whole arm and are shared by all its joints."""

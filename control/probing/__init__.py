"""The probing task: what is pressed where, how fast and how hard."""

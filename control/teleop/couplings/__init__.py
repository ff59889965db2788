"""Ways to couple a leader and a follower over a link with delay and loss: the rivals, one file each."""

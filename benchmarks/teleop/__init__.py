"""A leader's and a follower's device, a hand, an object and a link, to try couplings on."""

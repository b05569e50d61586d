"""What a swarm is: who belongs to which group, how each robot moves and reads volts, and where."""

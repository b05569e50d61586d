"""The simulated substrate: an independent witness that sees volts over time and nothing else."""

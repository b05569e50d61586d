"""What robots are really like, from measured poses: excitation, least squares, beliefs."""

"""Plays voltage sequences on a substrate of MicroStressBots, simulated or real."""

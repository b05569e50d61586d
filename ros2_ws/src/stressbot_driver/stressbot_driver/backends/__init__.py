"""Outputs onto a substrate, chosen by name through the entry-point group `stressbot_driver.backends`."""

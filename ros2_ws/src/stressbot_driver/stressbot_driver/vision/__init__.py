"""What a microscope above the substrate sees, and what can be read from its pictures."""

"""The tool `stressbot`."""

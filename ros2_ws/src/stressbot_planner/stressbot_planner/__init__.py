"""Motion planning and sequencing for swarms of MicroStressBots under group control."""

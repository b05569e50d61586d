"""Waveform generators that speak SCPI: what they are told, how it gets there, and an emulated one."""

"""What is in the water: one effect, one file."""

"""The ground: records, random numbers, elementary functions, and the one way to compile."""

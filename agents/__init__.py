"""Policies in use: the command line, the benchmark, and loading of saved agents."""

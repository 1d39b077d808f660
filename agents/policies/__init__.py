"""Policies by name, file or callable; saved agents; residuals."""

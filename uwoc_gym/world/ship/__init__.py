"""The ship above."""

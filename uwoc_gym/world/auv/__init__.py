"""The vehicle and what it carries."""

"""Training, tuning and calibrating: runs, settings, checkpoints, searches, seeds."""

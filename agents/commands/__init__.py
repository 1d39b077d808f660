"""The commands of `uwoc-gym`, one file each, named like it."""

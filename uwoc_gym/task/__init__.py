"""What an agent sees, does, is paid, and when it is over."""

"""One episode to look at: live, as a video, as a page."""

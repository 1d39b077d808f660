"""Errors that the command line shows as one line."""


class UserError(Exception):
    """Something the user can put right; its text is the whole message."""

"""A failure that the user can correct."""


class Failure(Exception):
    """The message for the user; the exit code is 1."""

"""What goes wrong in a way that the user can mend."""


class Failure(Exception):
    """What the user reads; the exit code is 1."""

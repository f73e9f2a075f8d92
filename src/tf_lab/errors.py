"""The one error a user is meant to see: what is wrong, in which file, and what to do."""


class TFLabError(Exception):
    """Bad input or configuration. The commands print it as one line and exit with status 2."""

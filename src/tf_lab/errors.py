"""The one error a user is meant to see: what is wrong, in which file, and what to do."""


class TFLabError(Exception):
    """Bad input or configuration. The commands print it as one line and exit with status 2."""

    def _render_traceback_(self) -> list[str]:
        """How notebooks (IPython) show it: as one line, too."""
        return [f"error: {self}"]

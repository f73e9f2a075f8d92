"""The page's server: for this machine only."""

from __future__ import annotations

import contextlib
import getpass
import io
import logging
import socket
import time

from tf_lab.errors import TFLabError

HOST = "127.0.0.1"

try:
    import viser
except ImportError as error:
    raise TFLabError("the viewer needs viser: pip install 'tf_lab[viewer]'") from error


class LocalServer(viser.ViserServer):
    """A server of viser that nobody else can reach, and that never asks its makers for a way in.

    Raises:
        TFLabError: the port is taken.
    """

    def __init__(self, port: int) -> None:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((HOST, port))
            except OSError as error:
                raise TFLabError(
                    f"port={port}: cannot be used ({error.strerror}), perhaps by another viewer; "
                    f"give port=N, as port={port + 1}"
                ) from error
        logging.getLogger("websockets").setLevel(logging.ERROR)
        with contextlib.redirect_stdout(io.StringIO()):  # its own words on where it is
            super().__init__(host=HOST, port=port, label="tf_lab", verbose=False)
        self.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        self.scene.set_up_direction("+z")

    def request_share_url(self, verbose: bool = True) -> str | None:
        """No: a page can ask for it even without the button."""
        return None

    def stop(self) -> None:
        """End it."""
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()

    @property
    def address(self) -> str:
        """Of the page."""
        return f"http://{HOST}:{self.get_port()}"

    def wait(self) -> None:
        """Say where the page is, until somebody interrupts."""
        port = self.get_port()
        print(f"{self.address}: open it in a browser; Ctrl-C ends it")
        print(
            f"from another machine: there, ssh -N -L {port}:{HOST}:{port} {_login()} first",
            flush=True,
        )
        try:
            while True:
                time.sleep(3600)
        finally:
            self.stop()


def _login() -> str:
    """Of ssh: user and host; the host alone where the system has no name for the user."""
    with contextlib.suppress(KeyError, OSError):  # before Python 3.13, and since
        return f"{getpass.getuser()}@{socket.gethostname()}"
    return socket.gethostname()

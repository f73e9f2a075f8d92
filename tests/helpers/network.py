"""No reach beyond this machine, in a process and in those that it starts."""

import os
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

LOOPBACK = ("127.0.0.1", "::1", "localhost", None, "")
REACHED = "TF_LAB_TESTS_REACHED"  # in the environment: the file that says who tried what


def closed(refuse: Callable[[str], NoReturn]) -> dict[tuple[Any, str], Any]:
    """What to set where, so that connections and look-ups beyond this machine are refused."""
    connect, look_up = socket.socket.connect, socket.getaddrinfo

    def checked_connect(self: socket.socket, address: Any) -> None:
        if self.family != socket.AF_UNIX and address[0] not in LOOPBACK:
            refuse(f"a connection to {address}")
        connect(self, address)

    def checked_look_up(host: Any, *arguments: Any, **more: Any) -> Any:
        if host not in LOOPBACK:
            refuse(f"a look-up of {host}")
        return look_up(host, *arguments, **more)

    return {(socket.socket, "connect"): checked_connect, (socket, "getaddrinfo"): checked_look_up}


def for_processes(folder: Path) -> dict[str, str]:
    """Environment in which every Python process is closed, and writes what it tried to a file."""
    (folder / "sitecustomize.py").write_text("from helpers import network\n\nnetwork.close()\n")
    path = os.pathsep.join([str(folder), *filter(None, sys.path)])
    return {"PYTHONPATH": path, REACHED: str(folder / "reached.txt")}


def close() -> None:
    """Of this process, once and for all."""
    for (owner, name), value in closed(_write_down).items():
        setattr(owner, name, value)


def _write_down(what: str) -> NoReturn:
    with Path(os.environ[REACHED]).open("a") as file:
        file.write(f"{' '.join(sys.argv)}: {what}\n")
    raise SystemExit(what)

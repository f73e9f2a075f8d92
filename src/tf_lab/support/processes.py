"""Processes that must not outlive the one that started them."""

from __future__ import annotations

import os
import threading
import time


def end_with(parent: int) -> None:
    """End this process when ``parent`` is not its parent any more, even if that was killed."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()

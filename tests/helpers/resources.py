"""What this process holds: memory and open files, again and again."""

import gc
import resource
from pathlib import Path


class Use:
    """Measured so often; flat if nothing leaks."""

    def __init__(self) -> None:
        self.memory: list[int] = []
        self.files: list[int] = []

    def measure(self) -> None:
        """Resident bytes, and how many files are open."""
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        self.memory.append(pages * resource.getpagesize())
        self.files.append(len([*Path("/proc/self/fd").iterdir()]))

    def growth(self) -> float:
        """Of memory from the end of the first fifth, in which all warms up, to the end."""
        return self.memory[-1] / self.memory[len(self.memory) // 5] - 1

    def assert_flat(self) -> None:
        """Memory within 2 %, and no more files."""
        print(f"memory {self.memory[-1] / 2**20:.0f} MiB, {self.growth():+.2%}")  # of pytest -s
        print(f"files {self.files[-1]}")
        assert self.growth() < 0.02, self.memory
        assert self.files[-1] <= self.files[len(self.files) // 5], self.files

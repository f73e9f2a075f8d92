"""Commands that are killed, stopped or run out of space, again and again; what that did, counted.

Every command works in a folder of its own, in which it is disturbed until it has ended by itself;
then what is there must be what an undisturbed one leaves.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import torch
from PIL import Image
from safetensors.torch import load_file

from helpers.layouts import plain, room_frames, seven_scenes
from helpers.made_up_runs import ROWS, write_study
from helpers.tiny_jobs import TINY, environment, start
from helpers.warm import Warm, warm_up
from tf_lab.meshes.files import read_mesh

MARK = "TF_LAB_TESTS_MARK"  # in the environment of a command and of all that it starts
PATIENCE = 300.0  # seconds after which a command hangs
GONE = 5.0  # seconds in which all processes of a stopped command are gone


@dataclass(frozen=True)
class Case:
    """A command, and what of its results must be the same whatever happened to it.

    Attributes:
        command: its name.
        words: its command line, given the folder that it writes to.
        results: patterns of files in that folder that must be equal.
    """

    command: str
    words: Callable[[Path], Sequence[str]]
    results: Sequence[str]


@dataclass
class Counts:
    """What happened to a command.

    Attributes:
        tries: how often it was disturbed.
        ended: how often it was done before.
        early: tries that ended it while the interpreter started, which hears no signals yet.
        status: tries that ended with another status than they should.
        lines: tries that did not say one line where they should, or said anything where not.
        orphans: tries of which a process lived on.
        half: files that are there by their names, but not whole.
        waited: starts that waited for a lock.
        compared: results held against those of an undisturbed command.
        differ: of them, those that differ.
        slowest: longest time from a signal to the end of the command, seconds.
        notes: what was seen where something was wrong.
    """

    tries: int = 0
    ended: int = 0
    early: int = 0
    status: int = 0
    lines: int = 0
    orphans: int = 0
    half: int = 0
    waited: int = 0
    compared: int = 0
    differ: int = 0
    slowest: float = 0.0
    notes: list[str] = field(default_factory=list)

    def wrong(self) -> int:
        """All that should be 0."""
        return self.status + self.lines + self.orphans + self.half + self.waited + self.differ


def prepare_inputs(folder: Path) -> dict[str, Case]:
    """Make what the commands of the cases read, and the cases."""
    cache = folder / "cache"
    os.environ["TF_LAB_CACHE"] = str(cache)
    inputs = folder / "inputs"
    inputs.mkdir(exist_ok=True)
    if not (inputs / "done").exists():
        done = start("train", *TINY, f"output={inputs / 'trained'}", cwd=folder)
        assert done.status == 0, done.err
        for name in ("kitchen", "office"):
            seven_scenes.write(inputs / "captures" / name, room_frames()[::3])
        shutil.rmtree(plain.write(inputs / "images", room_frames()[::3]) / "depth")
        write_study(inputs / "made_up", {row: 0.5 + 0.01 * i for i, row in enumerate(ROWS)})
        (run,) = inputs.glob("trained/runs/*")
        (inputs / "predictions").mkdir()
        (inputs / "groundtruth").mkdir()
        (scene,) = cache.glob("rooms-*/test/room_*")
        for i in range(2):
            shutil.copy(run / "meshes" / f"{scene.name}.ply", inputs / "predictions" / f"s{i}.ply")
            shutil.copytree(scene / "groundtruth", inputs / "groundtruth" / f"s{i}")
        (inputs / "done").touch()
    (checkpoint,) = inputs.glob("trained/trainings/*/model.safetensors")
    tiny = [*TINY, "optimizer.steps=20"]
    captures = ("data=captures", f"data.root={inputs / 'captures'}", "data.gravity=[0,0,-1]")
    benchmark = (
        *("model=tiny", "width=64", "height=48", "frames=2", "timed=1", "eager_timed=1"),
        *("views=[2]", "rooms=[1]", "counts=[2]", "resolution=0.1", "device=cpu"),
        *("model.far=2.5", "model.width=16", "model.blocks=1", "live_frames=2"),
        *("data.width=80", "data.height=60", "data.test_frames=24", "data.workers=1"),
    )
    weights, metrics = "**/model.safetensors", "**/metrics.json"
    return {
        "train": Case(
            "train",
            lambda to: [*tiny, "data.test_size=0", f"output={to}"],
            [weights],
        ),
        "train with 2 loaders": Case(
            "train",
            lambda to: [*tiny, "data.test_size=0", "trainer.workers=2", f"output={to}"],
            [weights],
        ),
        "sweep of 2 jobs": Case(
            "train",
            lambda to: [
                "-m",
                *TINY,
                "resolution=0.1",
                "seed=0,1",
                "launcher.jobs=2",
                f"output={to}",
            ],
            [weights, metrics, "**/*.ply"],
        ),
        "prepare": Case(
            "prepare",
            lambda to: [*captures, "data.width=48", "data.height=36", f"data.scenes={to}"],
            ["*/*/*", "*/*/*/*"],
        ),
        "evaluate": Case(
            "evaluate",
            lambda to: [
                f"predictions={inputs / 'predictions'}",
                f"groundtruth={inputs / 'groundtruth'}",
                f"output={to / 'scores.json'}",
            ],
            ["scores.json"],
        ),
        "report": Case(
            "report", lambda to: [f"runs={inputs / 'made_up' / 'runs'}", f"output={to}"], ["**/*.*"]
        ),
        "reconstruct": Case(
            "reconstruct",
            lambda to: [
                f"input={inputs / 'images'}",
                f"checkpoint={checkpoint}",
                *("device=cpu", "resolution=0.05", "check=false"),
                f"output={to / 'mesh.ply'}",
            ],
            ["mesh.ply", "mesh.png"],
        ),
        "benchmark": Case("benchmark", lambda to: [*benchmark, f"output={to}"], []),
    }


@dataclass(frozen=True)
class Undisturbed:
    """What a command does when nobody disturbs it.

    Attributes:
        expected: its results.
        usual: seconds that it takes as a fork of this process.
    """

    expected: dict[str, str]
    usual: float


def watch(case: Case, folder: Path) -> Undisturbed:
    """Run a command to its end, by a start of Python and as a fork; import here what it imports."""
    shutil.rmtree(folder, ignore_errors=True)
    for name in ("alone", "warm", "usual"):
        (folder / name).mkdir(parents=True)
    expected = results(case, undisturbed(case, folder / "alone"))
    warm_up(case.command, case.words(folder / "warm"), folder)
    counts, began = Counts(), time.monotonic()
    disturb(case, folder / "usual", signal.SIGKILL, False, PATIENCE, counts)
    usual = time.monotonic() - began
    compare(case, folder / "usual", expected, counts)
    assert counts.wrong() == 0, counts.notes
    return Undisturbed(expected, usual)


def stopped(
    case: Case,
    known: Undisturbed,
    folder: Path,
    number: signal.Signals,
    tries: int,
    group: bool = False,
    seed: int = 0,
    minutes: float = 1e6,
) -> Counts:
    """Send a command a signal, at a random moment, so many times.

    Args:
        case: the command.
        known: of it.
        folder: to work in.
        number: the signal.
        tries: how many.
        group: to all processes, as a terminal and a batch system do; else to the first.
        seed: of the moments.
        minutes: fewer tries, where they take longer.
    """
    end = time.monotonic() + 60 * minutes
    counts, rng = Counts(), random.Random(seed)
    shutil.rmtree(folder, ignore_errors=True)
    place, fresh = folder / "0", 0
    place.mkdir(parents=True)
    while counts.tries < tries and time.monotonic() < end:
        if disturb(case, place, number, group, rng.uniform(0.02, 1.0) * known.usual, counts):
            compare(case, place, known.expected, counts)
            fresh += 1
            place = folder / str(fresh)
            place.mkdir()
    disturb(case, place, number, group, PATIENCE, counts)
    compare(case, place, known.expected, counts)
    return counts


def undisturbed(case: Case, to: Path) -> Path:
    """Run a command to its end."""
    done = start(case.command, *case.words(to), cwd=to.parent)
    assert done.status == 0, done.err
    return to


def disturb(
    case: Case, to: Path, number: signal.Signals, group: bool, after: float, counts: Counts
) -> bool:
    """Start a command and send it a signal; whether it was done before."""
    mark = uuid.uuid4().hex
    out, err = to.parent / "out.txt", to.parent / "err.txt"
    process = Warm(case.command, case.words(to), to.parent, out, err, **{MARK: mark})
    sent = 0.0
    try:
        status = process.wait(after)
    except subprocess.TimeoutExpired:
        sent = time.monotonic()
        (os.killpg if group else os.kill)(process.pid, number)
        status = process.wait(PATIENCE)
        counts.slowest = max(counts.slowest, time.monotonic() - sent)
        if status == 0:  # it was about to end
            sent = 0.0
    printed, errors = out.read_text(), err.read_text()
    counts.waited += "waiting for" in printed
    if not sent:
        counts.ended += 1
        return check(status == 0, counts, "status", f"{status} undisturbed: {errors}")
    counts.tries += 1
    killed = number == signal.SIGKILL
    if status == -number and not killed and not printed + errors:  # before Python could hear it
        counts.early += 1
        return False
    check(status == (-number if killed else 128 + number), counts, "status", f"{status}: {errors}")
    said = lines(errors)
    good = not said if killed else len(said) == 1 and said[0].startswith(("interr", "stopped"))
    check(good, counts, "lines", errors)
    while (left := alive(mark, process.pid)) and time.monotonic() < sent + GONE:
        time.sleep(0.05)
    check(not left, counts, "orphans", str(left))
    for path in sorted(to.rglob("*")):
        if path.is_file() and ".partial-" not in str(path):
            check(whole(path), counts, "half", str(path))
    return False


def lines(errors: str) -> list[str]:
    """What a command says on standard error, progress bars apart."""
    return [
        line
        for line in errors.splitlines()
        if line.strip() and "-:--:--" not in line and "━" not in line
    ]


def check(good: bool, counts: Counts, what: str, note: str) -> bool:
    """Count what is wrong, and note it."""
    if not good:
        setattr(counts, what, getattr(counts, what) + 1)
        counts.notes.append(f"{what}: {note[:600]}")
    return True


def alive(mark: str, session: int) -> list[str]:
    """The command lines of all processes of a session, or with a mark in their environment."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            marked = f"{MARK}={mark}".encode() in (place / "environ").read_bytes().split(b"\0")
            marked |= os.getsid(int(place.name)) == session
            words = (place / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:  # it ended
            continue
        if marked and words:  # a dead one that nobody asked after has none
            found.append(words)
    return found


def whole(path: Path) -> bool:
    """Whether a file is what its name says."""
    try:
        if path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix == ".safetensors":
            load_file(path)
        elif path.suffix == ".ckpt":
            torch.load(path, weights_only=True)
        elif path.suffix in (".png", ".jpg"):
            with Image.open(path) as image:
                image.load()
        elif path.suffix == ".ply":
            read_mesh(path)
    except Exception:
        return False
    return True


def results(case: Case, folder: Path) -> dict[str, str]:
    """The results of a command: what is in them, by their places."""
    files = {p for pattern in case.results for p in folder.glob(pattern) if p.is_file()}
    return {
        str(path.relative_to(folder)): content(path)
        for path in sorted(files)
        if not path.name.startswith(".")
    }


def content(path: Path) -> str:
    """A hash of a file; of weights without their provenance, which tells of interruptions."""
    digest = hashlib.sha256()
    if path.suffix == ".safetensors":
        for name, value in sorted(load_file(path).items()):
            digest.update(name.encode() + value.numpy().tobytes())
    elif path.name == "metrics.json":
        scores = json.loads(path.read_text())
        digest.update(repr((scores["mean"], scores["scenes"])).encode())
    else:
        digest.update(path.read_bytes())
    return digest.hexdigest()


def compare(case: Case, folder: Path, expected: dict[str, str], counts: Counts) -> None:
    """Hold results against those of an undisturbed command."""
    found = results(case, folder)
    names = {name for name in {*found, *expected} if found.get(name) != expected.get(name)}
    counts.compared += 1
    check(not names, counts, "differ", f"{folder}: {sorted(names)}")


def full_disk(case: Case, folder: Path, levels: Sequence[float]) -> Counts:
    """Let a command run out of space: no file may be larger than a share of its largest.

    Args:
        case: the command.
        folder: to work in.
        levels: the shares.
    """
    counts = Counts()
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "undisturbed").mkdir(parents=True)
    whole_one = undisturbed(case, folder / "undisturbed")
    expected = results(case, whole_one)
    largest = max(path.stat().st_size for path in whole_one.rglob("*") if path.is_file())
    place = folder / "0"
    place.mkdir()
    for level in levels:
        limit = int(level * largest)
        done = subprocess.run(
            [sys.executable, "-m", f"tf_lab.{case.command}", *case.words(place)],
            cwd=folder,
            env=environment(),
            capture_output=True,
            text=True,
            preexec_fn=partial(resource.setrlimit, resource.RLIMIT_FSIZE, (limit, limit)),
        )
        counts.tries += 1
        check(done.returncode in (1, 2), counts, "status", f"{done.returncode}: {done.stderr}")
        said = lines(done.stderr)
        told = len(said) == 1 and "there is no space for it" in said[0] + done.stdout
        check(told, counts, "lines", done.stderr)
        for path in sorted(place.rglob("*")):
            if path.is_file():
                check(whole(path) and ".partial-" not in str(path), counts, "half", str(path))
    compare(case, undisturbed(case, place), expected, counts)
    return counts

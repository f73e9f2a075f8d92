"""`python -m tf_lab.view`: what it is asked for; the page has tests of its own."""

import socket
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from helpers.made_up_runs import write_run
from helpers.tiny_jobs import call
from tf_lab.config.compose import compose_config
from tf_lab.data.sources.source import open_source
from tf_lab.errors import TFLabError
from tf_lab.network.checkpoint import shipped_checkpoint
from tf_lab.reporting.results import read_run

pytest.importorskip("viser", reason="needs pip install 'tf_lab[viewer]'")
from tf_lab.commands.inputs import of_run


def test_a_run_is_seen_as_it_was_evaluated(tmp_path: Path, box_scene: Path) -> None:
    run = write_run(tmp_path, f"views=4 data.root={tmp_path}", 0, [0.5])
    asked = compose_config("view", "views=3")
    with pytest.raises(TFLabError, match=r"its checkpoint .* is not on this machine"):
        of_run(asked, run)
    checkpoint = tmp_path / "trainings" / "tiny-seed0-abc" / "model.safetensors"
    checkpoint.parent.mkdir(parents=True)
    checkpoint.touch()
    with pytest.raises(TFLabError, match=r"its test scene .* is not on this machine"):
        of_run(asked, run)
    scene = open_source(read_run(run).config.data).directory("room_2000000", None)
    scene.parent.mkdir(parents=True)
    scene.symlink_to(box_scene)
    config, scenes = of_run(asked, run)
    assert config.checkpoint == str(checkpoint) and config.views == 4
    assert [scene.name for scene in scenes.values()] == ["box_room"]
    with pytest.raises(TFLabError, match=r"scene=nowhere: .* has room_2000000"):
        of_run(replace(asked, scene="nowhere"), run)


def test_a_runs_checkpoint_is_found_from_elsewhere(
    tmp_path: Path, box_scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is kept as the training was told its folder: by default from where that was called."""
    monkeypatch.chdir(tmp_path)
    run = write_run(Path("outputs"), f"data.root={tmp_path}", 0, [0.5])
    checkpoint = Path("outputs/trainings/tiny-seed0-abc/model.safetensors")
    checkpoint.parent.mkdir(parents=True)
    checkpoint.touch()
    scene = open_source(read_run(run).config.data).directory("room_2000000", None)
    scene.parent.mkdir(parents=True)
    scene.symlink_to(box_scene)
    asked = compose_config("view")
    assert of_run(asked, run)[0].checkpoint == str(checkpoint)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    found, _ = of_run(asked, tmp_path / run)
    assert found.checkpoint == str(tmp_path / checkpoint)


def test_runs_are_seen_side_by_side(
    tmp_path: Path, box_scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each with its own settings, on one scene that all were tested on."""
    rows = ("views=4", "views=8 select=rnd")
    one, two = (
        write_run(tmp_path / str(n), f"{row} data.root={tmp_path}", 0, [0.5])
        for n, row in enumerate(rows)
    )
    for n in range(2):
        checkpoint = tmp_path / str(n) / "trainings" / "tiny-seed0-abc" / "model.safetensors"
        checkpoint.parent.mkdir(parents=True)
        checkpoint.symlink_to(shipped_checkpoint())
    scene = open_source(read_run(one).config.data).directory("room_2000000", None)
    scene.parent.mkdir(parents=True)
    scene.symlink_to(box_scene)
    shown: list[Any] = []

    def show(server: Any, sides: Any, capture: Any, frames: Any, truth: Any) -> list[Any]:
        shown.append((sides, capture))
        return []

    monkeypatch.setattr("tf_lab.commands.view.show_sessions", show)
    monkeypatch.setattr("tf_lab.viewer.serve.LocalServer.wait", lambda server: server.stop())
    done = call("view", f"run=[{one},{two}]", "port=0")
    assert (done.status, done.err) == (0, "")
    ((sides, capture),) = shown
    assert capture.name == "box_room"
    found = [(side.views, side.select.policy) for _, side in sides.values()]
    assert found == [(4, "attention"), (8, "random")]
    assert len({*sides}) == 2 and all(name in str(one) + str(two) for name in sides)
    for given, said in (
        (f"run=[{one},{one}]", f"run={one}: is given twice"),
        (f"run=[{one},{two}] checkpoint=a", "checkpoint= goes with one run="),
        ("run=[]", "an empty list shows nothing"),
    ):
        done = call("view", *given.split(" "), "port=0")
        assert done.status == 2 and said in done.err and len(done.err.splitlines()) == 1


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("input=a", "run=b"), "give one of input=, run= and mesh="),
        (("port=70000",), "port=70000: must be at least 0 and at most 65535"),
        (("mesh=nowhere.ply", "port=0"), "nowhere.ply: cannot be read"),
        (("run=nowhere", "port=0"), "run=nowhere: no such folder; `python -m tf_lab.runs` lists"),
        (("run=.", "port=0"), "run=.: no run, there is no config.yaml in it"),
    ],
)
def test_errors_are_a_line(given: tuple[str, ...], said: str) -> None:
    done = call("view", *given)
    assert done.status == 2
    assert said in done.err and len(done.err.splitlines()) == 1


def test_a_taken_port_is_told_before_anything_is_done() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        done = call("view", f"port={other.getsockname()[1]}")
    assert done.status == 2
    assert "cannot be used" in done.err and len(done.err.splitlines()) == 1


def test_a_user_without_a_name_is_told_the_way_in(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from tf_lab.viewer.serve import LocalServer

    def nobody() -> str:
        raise KeyError("getpwuid(): uid not found: 12345")

    def interrupt(seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("getpass.getuser", nobody)
    monkeypatch.setattr("time.sleep", interrupt)
    with pytest.raises(KeyboardInterrupt):
        LocalServer(0).wait()
    assert f" {socket.gethostname()} first" in capsys.readouterr().out


def test_meshes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Side by side under one camera, the ground truth last; GLB and PLY alike."""
    from tf_lab.meshes.glb import glb_of
    from tf_lab.viewer.serve import LocalServer

    cube = trimesh.creation.box((2, 1, 1))
    cube.export(tmp_path / "a.ply")
    (tmp_path / "b.glb").write_bytes(glb_of(cube))
    seen: dict[str, Any] = {}

    def look(server: Any) -> None:
        for number in range(4):
            seen[str(number)] = server.scene.get_handle_by_name(f"/{number}")
        server.stop()

    monkeypatch.setattr(LocalServer, "wait", look)
    done = call("view", "mesh=[a.ply,b.glb]", "groundtruth=a.ply", "port=0")
    assert (done.status, done.err) == (0, "")
    places = [np.array(seen[n].position) for n in "012"]
    np.testing.assert_allclose(np.diff(places, axis=0), [[2.5, 0, 0]] * 2)
    assert seen["3"] is None

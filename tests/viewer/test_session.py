"""A session without a page: frames, mesh, clock, picked point."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
import trimesh

from helpers.online.scenes import FRAMES, assert_same_surface, clearance, reconstruct
from helpers.resources import Use
from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.evaluation.truth import Truth
from tf_lab.geometry import CHUNK, FINE
from tf_lab.meshes.raycast import CLAY
from tf_lab.meshes.weld import weld
from tf_lab.support.colors import error_colors, frame_colors
from tf_lab.viewer import session as module
from tf_lab.viewer.paint import painter
from tf_lab.viewer.session import Session


def finish(session: Session) -> Any:
    """Work until nothing is left to do; what was told."""
    while session.work():
        pass
    return session.listener


def whole(told: Any) -> trimesh.Trimesh:
    """The pieces as one mesh."""
    parts = [(np.asarray(p.vertices), np.asarray(p.faces)) for p in told.pieces.values()]
    return trimesh.Trimesh(*weld(parts, tolerance=1e-5), process=False)


def test_the_pieces_are_the_mesh_of_the_frames_so_far(
    session: Session, network: Any, scene: Scene
) -> None:
    for count in (2, 3):
        session.jump(count)
        told = finish(session)
        assert told.frames == list(FRAMES[:count])
        assert (told.state.position, told.state.busy) == (count, "")
        reference = reconstruct(network, scene, FRAMES[:count], resolution=0.1).mesh(color=False)
        assert_same_surface(whole(told), reference)


def test_only_what_changed_is_told(session: Session) -> None:
    session.jump(3)
    told = finish(session)
    before, told.told = dict(told.pieces), []
    session.step()
    finish(session)
    again = set(told.told) & set(before)
    assert again and all(len(before[c].vertices) for c in again)
    for chunk in again & set(told.pieces):
        old, new = (np.asarray(pieces[chunk].vertices) for pieces in (before, told.pieces))
        assert not np.array_equal(old, new)
    told.told = []
    session.growth.stale.update(told.pieces.keys())  # as if a frame had come that changes nothing
    finish(session)
    assert told.told == []


def test_chunks_whose_voxels_changed_wait(session: Session) -> None:
    """By the places of the voxels: coarse blocks (0.9 m) lie across the chunks' borders."""
    for frame in FRAMES[:3]:
        session.growth.add(session.capture, frame)
        r = session.growth.reconstructor
        changed = r.coarse.points(r.coarse.store.dirty.nonzero()[:, 0]).numpy()
        held = {tuple(map(int, chunk)) for chunk in np.floor(changed / CHUNK)}
        touched = {
            tuple(map(int, chunk))
            for side in np.stack(np.meshgrid(*[[-0.9, 0, 0.9]] * 3), -1).reshape(-1, 3)
            for chunk in np.floor((changed + side) / CHUNK)
        }
        assert held <= set(session.growth.stale) <= touched
        session.growth.settle()


def test_chunks_with_and_without_surface_take_turns(session: Session) -> None:
    """Frames reach behind walls: what they changed there must not keep the mesh from growing."""
    growth = session.growth
    for frame in FRAMES[:3]:
        growth.add(session.capture, frame)
    growth.settle()
    seen = list(growth.pieces)[:2]
    behind = [(90, 90, z) for z in range(4)]  # where no voxels are
    growth.stale.update({seen[0]: 1, seen[1]: 2} | {c: 10 + c[2] for c in behind})
    order = []
    while growth.stale:
        left = set(growth.stale)
        assert growth.mesh_next() == {}
        order += left - set(growth.stale)
    assert order == [seen[1], behind[3], seen[0], behind[2], behind[1], behind[0]]


def test_chunks_that_come_out_as_before_let_one_frame_pass(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frame takes 0.1 s here, a chunk nothing, and the mesh is old after 0.25 s."""
    now, done = [100.0], []
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(module, "REFRESH", 0.25)
    monkeypatch.setattr(session.growth, "add", lambda *_: now.append(now.pop() + 0.1))
    outcomes = iter([{}, {}, {(0, 0, 0): None}, {}])

    def mesh_next(roughly: bool) -> Any:
        assert roughly  # there are frames to come
        done.append(session.position)
        return next(outcomes)

    monkeypatch.setattr(session.growth, "mesh_next", mesh_next)
    session.growth.stale[0, 0, 0] = 9
    session.frames, session.speed = [0] * 20, 1000
    session.play(True)
    while len(done) < 4:
        session.work()
    # at once; after one frame each; after three (0.3 s) the mesh is old again
    assert done == [0, 1, 2, 5]


def click(session: Session, scene: Scene) -> tuple[np.ndarray, Any]:
    """Click the middle of the face that most frames see, from the front: it, and what is told."""
    mesh = whole(session.listener)
    middles = np.asarray(mesh.triangles_center)
    face = np.sum([clearance(middles, scene, f) > 0 for f in FRAMES], 0).argmax()
    normal = mesh.face_normals[face]
    session.pick(middles[face] + 0.01 * normal, -normal)
    return middles[face], finish(session)


def test_a_click_shows_the_views_that_see_the_point(full: Session, scene: Scene) -> None:
    point, told = click(full, scene)
    pick = told.pick
    np.testing.assert_allclose(pick.point, point, atol=1e-4)
    center = (np.floor(point / FINE) + 0.5) * FINE
    seen = {f for f in FRAMES if clearance(center[None], scene, f)[0] > 0}
    assert {view.source for view in pick.views} == seen and len(seen) > 1
    assert pick.weights.sum() == pytest.approx(1, abs=1e-5)
    assert (np.diff(pick.weights) <= 0).all()
    frames, weights = full.growth.reconstructor.view_weights(point[None])
    by_frame = dict(zip(frames[0].tolist(), weights[0].tolist(), strict=True))
    for view in pick.views:
        assert view.weight == pytest.approx(by_frame[FRAMES.index(view.source)])


def test_a_click_while_the_last_one_is_looked_for(
    full: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[float] = []

    def hit(origin: np.ndarray, direction: np.ndarray) -> None:
        looked.append(float(origin[0]))
        if len(looked) == 1:
            full.pick(np.ones(3), direction)

    monkeypatch.setattr(full.growth, "hit", hit)
    full.pick(np.zeros(3), np.array([0.0, 0, -1]))
    finish(full)
    assert looked == [0, 1]


def test_the_point_is_marked_in_the_images(full: Session, scene: Scene) -> None:
    point, told = click(full, scene)
    for view in told.pick.views:
        pose, K = scene.world_T_cam[view.source], scene.K[view.source]
        pixel = K @ ((point - pose[:3, 3]) @ pose[:3, :3])
        column, row = pixel[:2] / pixel[2]
        rows, columns = np.nonzero((view.image != scene.image(view.source)).any(-1))
        assert rows.min() == max(round(row) - 4, 0)
        assert columns.min() == max(round(column) - 4, 0)
        assert rows.max() == min(round(row) + 4, scene.size[1] - 1)
        assert columns.max() == min(round(column) + 4, scene.size[0] - 1)


def test_other_settings_reconstruct_the_same_frames_again(session: Session, scene: Scene) -> None:
    session.jump(3)
    coarse = finish(session)
    before = click(session, scene)[1].pick
    faces = len(whole(coarse).faces)
    session.change(views=1, resolution=0.05)
    told = finish(session)
    assert len(before.views) > 1 and len(told.pick.views) == 1
    assert told.pick.weights == pytest.approx([1])
    assert told.frames == list(FRAMES[:3])
    assert len(whole(told).faces) > 2 * faces
    with pytest.raises(TFLabError, match="views=0"):
        session.change(views=0)
    assert session.settings.views == 1 and not session.work()


def test_backwards_starts_again(session: Session) -> None:
    session.jump(2)
    finish(session)
    session.jump(1)
    assert finish(session).frames == list(FRAMES[:1])
    session.jump(-5)
    told = finish(session)
    assert told.frames == [] and told.pieces == {}


def test_it_plays_at_its_speed(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    session.frames, session.speed = session.frames[:3], 10
    session.play(True)
    added = []
    for _ in range(8):
        finish(session)
        added.append(session.position)
        now[0] += 0.0501
    assert added == [1, 1, 2, 2, 3, 3, 3, 3]
    assert session.listener.state.playing is False  # there are no more


def test_a_frame_that_cannot_be_read_is_left_out(session: Session, scene: Scene) -> None:
    session.frames = [FRAMES[0], 10_000, FRAMES[1]]
    session.capture = Broken(scene)
    session.jump(3)
    with pytest.raises(TFLabError, match="frame 10000"):
        finish(session)
    assert finish(session).frames == list(FRAMES[:2])


def test_what_breaks_off_is_told_and_the_page_lives_on(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    add = session.growth.add
    trouble: list[str] = []

    def short(*args: Any) -> None:
        monkeypatch.setattr(session.growth, "add", add)
        raise MemoryError("too little")

    def stated(state: Any) -> None:
        trouble.append(state.trouble)
        session.listener.state = state

    monkeypatch.setattr(session.growth, "add", short)
    monkeypatch.setattr(session.listener, "stated", stated)
    thread = session.start()
    try:
        session.jump(1)
        wait_until(lambda: "MemoryError: too little" in trouble)
        session.jump(3)
        wait_until(lambda: len(session.growth) == 2)  # the first of the three was lost
    finally:
        session.stop()
        thread.join(20)
    assert not thread.is_alive()


def wait_until(true: Callable[[], bool]) -> None:
    """Or fail after a while."""
    end = time.monotonic() + 60
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


class Broken:
    """A scene with a frame that cannot be read."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.K, self.world_T_cam = scene, scene.K, scene.world_T_cam
        self.frames = scene.frames

    def image(self, index: int) -> np.ndarray:
        if index == 10_000:
            raise TFLabError("frame 10000: cannot be read")
        return self.scene.image(index)


def test_colours(full: Session, scene: Scene) -> None:
    full.paint("image")
    told = finish(full)
    for chunk, piece in told.pieces.items():
        assert told.colors[chunk].shape == piece.vertices.shape
        assert told.colors[chunk].dtype == np.uint8
    full.paint("best view")
    finish(full)
    chunk = max(told.pieces, key=lambda c: len(told.pieces[c].vertices))
    points = np.asarray(told.pieces[chunk].vertices)
    frames, weights = full.growth.reconstructor.view_weights(points)
    best = np.array(FRAMES)[frames[np.arange(len(points)), weights.argmax(1)]]
    expected = frame_colors(best, len(scene.frames))
    assert (told.colors[chunk] == expected).all(1).mean() > 0.99  # vertices between two voxels
    truth = trimesh.creation.box((20, 20, 0.001))
    full.truth = lambda: Truth(truth)
    full.paint("error")
    told = finish(full)
    far = np.abs(points[:, 2]) > 0.2
    assert (told.colors[chunk][far] == error_colors(np.array([1.0]))).all()


def test_what_lies_between_a_piece_and_its_cameras_hides_it(
    full: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    pieces = full.growth.pieces
    piece = max(pieces.values(), key=lambda p: len(p.vertices))
    centers = [pose[:3, 3].numpy() for _, pose in full.growth.reconstructor.frames.poses]

    def painted(at: Sequence[np.ndarray]) -> np.ndarray:
        """With a small closed box, densely meshed, around each of some points."""
        box = trimesh.creation.box((0.6, 0.6, 0.6))
        for _ in range(7):
            box = box.subdivide()
        for i, point in enumerate(at):
            moved = box.copy().apply_translation(point)
            monkeypatch.setitem(pieces, (1000 + i, 0, 0), moved)
        return painter("image", full.growth, 1, lambda: None)(piece)

    alone = painted([])
    assert (alone != 128).any(1).mean() > 0.5
    assert (painted([np.array([0, 0, 50.0])]) == alone).all()
    assert (painted(centers) == 128).all(1).mean() > 0.95


def test_surface_that_no_frame_sees_has_a_colour(full: Session) -> None:
    away = trimesh.creation.box(
        (0.1, 0.1, 0.1), trimesh.transformations.translation_matrix([90] * 3)
    )
    colors = painter("image", full.growth, 1, lambda: None)(away)
    assert (colors == np.round(255 * np.array(CLAY))).all()


def test_other_colours_come_before_more_frames(session: Session) -> None:
    """However long the frames, and the chunks that they change, have been waiting."""
    session.jump(3)
    finish(session)
    session.jump(len(FRAMES))
    assert session.work() and session.growth.stale
    session.paint("image")
    position, told = session.position, session.listener
    clay = np.round(255 * np.array(CLAY))
    for _ in range(len(session.growth.pieces)):
        assert session.work() and session.position == position
    assert all((told.colors[chunk] != clay).any() for chunk in told.pieces)
    finish(session)
    assert session.position == len(FRAMES)
    assert all((told.colors[chunk] != clay).any() for chunk in told.pieces)


def test_without_ground_truth_there_is_no_error(session: Session) -> None:
    session.jump(1)
    session.paint("error")
    with pytest.raises(TFLabError, match="no ground truth"):
        finish(session)
    told = finish(session)  # it goes on as before
    assert told.pieces.keys() == told.colors.keys() and session.mode == "image"


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_two_hundred_steps_leak_nothing(session: Session) -> None:
    use = Use()
    for step in range(200):
        session.jump(1 + step % len(FRAMES))
        finish(session)
        if step % len(FRAMES) == 0:
            use.measure()
    use.assert_flat()

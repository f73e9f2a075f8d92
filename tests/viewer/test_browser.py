"""The page in a real browser."""

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from helpers.browser import Page, browser
from tf_lab.data.scene import Scene
from tf_lab.errors import TFLabError
from tf_lab.viewer.session import Session

pytest.importorskip("viser", reason="needs pip install 'tf_lab[viewer]'")

READY = "document.body.textContent.includes('up to date')"
VIEWS = "[...document.querySelectorAll('.kept-view')].map(e => [e.dataset.frame, e.dataset.weight])"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def page_of(plain: Session, *names: str) -> Iterator[list[Session]]:
    """Sessions like one, of these names, with a page."""
    from tf_lab.viewer.live import show_sessions
    from tf_lab.viewer.serve import LocalServer

    server = LocalServer(free_port())
    sides = dict.fromkeys(names, (plain.network, plain.settings))
    sessions = show_sessions(server, sides, plain.capture, plain.frames, lambda: None)
    for session in sessions:
        session.server = server  # type: ignore[attr-defined]
    yield sessions
    server.stop()


@contextmanager
def at_work(sessions: list[Session]) -> Iterator[None]:
    """Their threads."""
    threads = [session.start() for session in sessions]
    yield
    for session, thread in zip(sessions, threads, strict=True):
        session.stop()
        thread.join(60)


@pytest.fixture
def session(make_session: Callable[[], Session]) -> Iterator[Session]:
    """One with a page, at work."""
    with page_of(make_session(), "box") as sessions, at_work(sessions):
        yield sessions[0]


def pixel(session: Session, point: np.ndarray) -> tuple[float, float]:
    """Where the page shows a point."""
    (client,) = session.server.get_clients().values()  # type: ignore[attr-defined]
    camera = client.camera
    w, x, y, z = camera.wxyz
    ahead = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    right = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
    local = point - camera.position
    scale = camera.image_height / 2 / np.tan(camera.fov / 2) / (local @ ahead)
    across, down = local @ right, local @ np.cross(ahead, right)
    return camera.image_width / 2 + scale * across, camera.image_height / 2 + scale * down


def views(page: Page) -> list[tuple[int, float]]:
    return [(int(frame), float(weight)) for frame, weight in page.evaluate(VIEWS)]


def settled(page: Page) -> np.ndarray:
    """The scene when nothing is left to do, without the panel beside it."""
    page.wait(READY)
    before, now = None, page.picture()
    while before is None or (before != now).any():  # until it is drawn
        time.sleep(1.5)
        before, now = now, page.picture()
    return now[:, :700]


def step(page: Page, count: int) -> None:
    """Add one frame, the count-th."""
    page.click_text("Step")
    page.wait(f"document.body.textContent.includes('{count} of 6 frames')")


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.timeout(900)  # beside other work
def test_the_page(session: Session) -> None:
    with browser() as page:
        page.open(session.server.address)  # type: ignore[attr-defined]
        page.wait("document.querySelectorAll('canvas').length")
        page.wait(READY)
        page.wait("document.body.textContent.includes('0 of 6 frames')")
        time.sleep(2)  # until the panel stands still
        for count in (1, 2, 3):
            step(page, count)
        three = settled(page)
        assert three.std() > 5  # not blank
        for count in (4, 5, 6):
            step(page, count)
        six = settled(page)
        assert (np.abs(six.astype(int) - three).max(-1) > 20).mean() > 0.002

        pieces = session.growth.pieces.values()
        (client,) = session.server.get_clients().values()  # type: ignore[attr-defined]
        eye = np.array(client.camera.position)
        best = max(
            (
                session.growth.hit(eye, middle - eye)
                for piece in pieces
                for middle in np.asarray(piece.triangles_center)[::10]
            ),
            key=lambda p: -1 if p is None else held(session, p),
        )
        assert best is not None
        page.click(*pixel(session, best))
        page.wait("document.querySelectorAll('.kept-view img').length")
        shown = views(page)
        assert len(shown) == held(session, best)
        assert sum(weight for _, weight in shown) == pytest.approx(1, abs=1e-3)
        assert shown == sorted(shown, key=lambda view: -view[1])

        session.change(views=2)
        page.wait("document.querySelectorAll('.kept-view').length == 2")
        page.wait(READY)
        attention = views(page)
        before = settled(page)
        page.click_first("input[value=image]")
        page.click_text("best view", "[role=option]")
        page.wait("document.body.textContent.includes('of greatest weight')")
        page.wait(READY)
        assert (np.abs(settled(page).astype(int) - before).max(-1) > 20).mean() > 0.002
        page.click_first("input[value=attention]")
        page.click_text("random", "[role=option]")
        page.wait(f"JSON.stringify({VIEWS}) != {repr_of(page)} && {READY}")
        assert {frame for frame, _ in views(page)} != {frame for frame, _ in attention}
        own = session.server.address  # type: ignore[attr-defined]
        others = [url for url in page.requests if not url.startswith((own, "data:", "blob:"))]
        assert others == []


def repr_of(page: Page) -> str:
    """The views now shown, as a text of JavaScript."""
    return repr(page.evaluate(f"JSON.stringify({VIEWS})"))


def held(session: Session, point: np.ndarray) -> int:
    frames, _ = session.growth.reconstructor.view_weights(point[None])
    return int((frames >= 0).sum())


def test_two_networks_stand_side_by_side(make_session: Callable[[], Session]) -> None:
    with page_of(make_session(), "a", "b") as sessions:
        for session in sessions:
            session.jump(1)
            while session.work():
                pass
        find = sessions[0].server.scene.get_handle_by_name  # type: ignore[attr-defined]
        places = []
        for number, session in enumerate(sessions):
            assert session.growth.pieces
            for chunk in session.growth.pieces:
                assert find(f"/scene{number}/mesh/{'_'.join(map(str, chunk))}") is not None
            places.append(np.array(find(f"/scene{number}").position))
        centers = sessions[0].capture.world_T_cam[:, :3, 3]
        step = places[1] - places[0]
        assert step[0] > np.ptp(centers[:, 0]) + 2 and (step[1:] == 0).all()


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.timeout(900)  # beside other work
def test_two_networks_are_asked_alike(make_session: Callable[[], Session]) -> None:
    with page_of(make_session(), "a", "b") as sessions, at_work(sessions), browser() as page:
        page.open(sessions[0].server.address)  # type: ignore[attr-defined]
        page.wait("document.body.textContent.includes('b: 0 of 6 frames')")
        time.sleep(2)
        page.click_text("Step")
        for name in ("a", "b"):
            page.wait(f"document.body.textContent.includes('{name}: 1 of 6 frames')")


def test_a_taken_port_is_said(scene: Scene) -> None:
    from tf_lab.viewer.serve import LocalServer

    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(TFLabError, match=f"port={port}: cannot be used .*give port="):
            LocalServer(port)

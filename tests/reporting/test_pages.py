"""Pages of studies and runs: all in one file, and nothing is asked of anybody."""

import base64
import re
import time
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from helpers.browser import browser
from helpers.made_up_runs import write_run
from tf_lab.reporting.pages import run_page, study_page, write_pages
from tf_lab.reporting.studies import Study, open_study
from tf_lab.support.layout import mesh_path

ROOM = "room_2000000"


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two rows of two seeds; ours has a mesh and a picture of its first scene."""
    output = tmp_path_factory.mktemp("pages")
    for overrides, seed, score in (("", 0, 0.5), ("", 1, 0.6), ("views=4", 0, 0.4)):
        run = write_run(output, overrides, seed, [score, 0.8])
    mesh = trimesh.creation.icosphere(3).apply_translation([1, 2, 3])
    colors = np.where(mesh.vertices[:, 2:] > 3, [250, 10, 10], [10, 10, 250]).astype(np.uint8)
    mesh.visual.vertex_colors = colors
    ours = next(path for path in (output / "runs").iterdir() if "views16-attn-seed0" in path.name)
    for folder in ("meshes", "pictures"):
        (ours / folder).mkdir()
    mesh.export(ours / "meshes" / f"{ROOM}.ply")
    Image.new("RGB", (400, 300), (90, 160, 90)).save(ours / "pictures" / f"{ROOM}.png")
    assert run.exists()
    return output


@pytest.fixture(scope="module")
def study(output: Path) -> Study:
    return open_study([output / "runs"])[0]


class Reader(HTMLParser):
    """What a page refers to, what it says, and the data of its canvas."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.places: list[str] = []
        self.cells: list[str] = []
        self.canvas: dict[str, str] = {}
        self.scripts: list[str] = []
        self._within: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._within.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "srcset", "data", "action", "poster", "background"):
                self.places.append(value or "")
        if tag == "canvas":
            self.canvas = {name: value or "" for name, value in attrs}

    def handle_endtag(self, tag: str) -> None:
        while self._within and self._within.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if self._within and self._within[-1] in ("td", "b", "pre", "p"):
            self.cells.append(data)
        if self._within and self._within[-1] in ("script", "style"):
            self.scripts.append(data)


def assert_asks_nobody(text: str) -> Reader:
    page = Reader(text)
    assert page.places and all(place.startswith("data:") for place in page.places)
    for script in page.scripts:
        assert not re.search(r"fetch|XMLHttp|WebSocket|import|url\(|https?:|sendBeacon", script)
    for place in page.places:
        kind, _, content = place.partition(",")
        if "svg" in kind:
            inside = base64.b64decode(content).decode()
            used = re.findall(r"(?:href|src)\s*=\s*[\"']([^\"']*)|url\(([^)]*)\)", inside)
            assert all((a or b).startswith(("#", "data:")) for a, b in used)
            assert "F-score" in inside  # axes are named, as text
    assert "default-src 'none'" in text
    return page


def test_a_study(study: Study) -> None:
    page = assert_asks_nobody(study_page(study, "Three runs.", ["a < b"], Path("nowhere")))
    assert {"Three runs.", "a < b", "Ours", "Ours: 4 images"} <= set(page.cells)
    # over seeds 0 and 1 and over scenes of 0.5, 0.6 and 0.8, by hand
    assert any(cell.strip() in ("0.675", "0.675 ± 0.035") for cell in page.cells)


def test_a_run(study: Study) -> None:
    page = assert_asks_nobody(run_page(study.runs["Ours", 0]))
    assert {ROOM, "0.500", "0.800", "0.650"} <= set(page.cells)
    assert any("python -m tf_lab.train" in cell for cell in page.cells)
    assert any("keyframe_distance: 0.1" in cell for cell in page.cells)
    assert sum(place.startswith("data:image/jpeg") for place in page.places) == 1


def test_a_run_without_meshes_has_no_view(study: Study) -> None:
    assert "<canvas" not in run_page(study.runs["Ours: 4 images", 0])


def test_a_damaged_mesh_costs_its_view_only(study: Study) -> None:
    path = mesh_path(study.runs["Ours", 0].directory, ROOM)
    whole = path.read_bytes()
    path.write_bytes(whole[:300])
    try:
        for text in (run_page(study.runs["Ours", 0]), study_page(study, "", [], Path("nowhere"))):
            assert "<canvas" not in text
            assert any("not a readable PLY mesh" in cell for cell in Reader(text).cells)
    finally:
        path.write_bytes(whole)


def test_the_mesh_in_the_page(study: Study) -> None:
    """Places are 16 bits over the bounding box, from the middle of which the page looks."""
    canvas = Reader(run_page(study.runs["Ours", 0])).canvas

    def values(name: str, dtype: str) -> np.ndarray:
        return np.frombuffer(base64.b64decode(canvas[f"data-{name}"]), dtype).reshape(-1, 3)

    size = np.array([float(x) for x in canvas["data-size"].split(",")])
    np.testing.assert_allclose(size, 2, atol=0.01)
    places = (values("places", "<u2") / 65535 - 0.5) * size
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), 1, atol=1e-3)
    faces = values("faces", "<u4")
    assert len(faces) == 20 * 4**3 and faces.max() == len(places) - 1
    red = values("colors", "u1")[:, 0] > 128
    np.testing.assert_array_equal(red, places[:, 2] > 1e-4)


@pytest.mark.slow
@pytest.mark.browser
def test_in_a_browser(study: Study, output: Path) -> None:
    """Nothing is requested but the file; the mesh is drawn, and turns."""
    write_pages(study, "Three runs.", [], output)
    with browser((900, 900)) as page:
        page.open((output / "report.html").as_uri())
        page.wait("document.querySelectorAll('canvas').length")
        page.evaluate("document.querySelector('canvas').scrollIntoView({block: 'center'})")
        time.sleep(1)
        before = page.picture()
        red, blue = before[..., 0].astype(int), before[..., 2].astype(int)
        assert (red - blue > 60).mean() > 0.01 and (blue - red > 30).mean() > 0.002
        page.call("Input.dispatchMouseEvent", type="mousePressed", x=450, y=450, button="left")
        page.call(
            "Input.dispatchMouseEvent", type="mouseMoved", x=450, y=250, button="left", buttons=1
        )
        page.call("Input.dispatchMouseEvent", type="mouseReleased", x=450, y=250, button="left")
        time.sleep(1)
        assert (np.abs(page.picture().astype(int) - before).max(-1) > 50).mean() > 0.01
        assert all(url.startswith(("file:", "data:")) for url in page.requests)

"""Finding shards by path, pattern and URL; indices that are not what they should be."""

import functools
import http.server
import itertools
import json
import re
import shutil
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from helpers import small_shards
from helpers.small_shards import SETTINGS, sampler
from tf_lab.data.shard_set import open_shards
from tf_lab.data.shard_stream import ShardStream
from tf_lab.errors import TFLabError

NAME = re.compile(r"chunks-\d+\.tar")


@pytest.fixture(scope="module")
def written(box_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """16 chunks in 4 shards. Don't write to them."""
    directory = tmp_path_factory.mktemp("shards")
    small_shards.write(directory, sampler(box_scene))
    return directory


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None: ...


@pytest.fixture(scope="module")
def server(written: Path) -> Iterator[str]:
    """The shards over HTTP."""
    if not shutil.which("curl"):
        pytest.skip("webdataset reads from servers with curl")
    handler = functools.partial(Quiet, directory=str(written))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{running.server_port}"
        running.shutdown()


def place(url: str, written: Path, request: pytest.FixtureRequest) -> str:
    """A URL with the directory (0) or the server (1) filled in."""
    return url.format(written, request.getfixturevalue("server") if "{1}" in url else "")


@pytest.mark.parametrize(
    ("urls", "shards"),
    [
        ("{0}", 4),
        ("{0}/shards.json", 4),
        ("{0}/chunks-{{000000..000003}}.tar", 4),
        ("{0}/chunks-*.tar", 4),
        (["{0}/chunks-000002.tar", "{0}/chunks-00000[01].tar", "{0}/chunks-000002.tar"], 3),
        ("file://{0}/chunks-000001.tar", 1),
        ("pipe:cat {0}/chunks-{{000000,000003}}.tar", 2),
        ("pipe:cat {0}/shards.json", 4),
        ("{1}/", 4),
        ("{1}/chunks-{{000000..000002}}.tar", 3),
    ],
)
def test_urls(
    written: Path, urls: str | list[str], shards: int, request: pytest.FixtureRequest
) -> None:
    given = [urls] if isinstance(urls, str) else urls
    given = [place(url, written, request) for url in given]
    found = open_shards(given if isinstance(urls, list) else given[0])
    assert len(found.shards) == shards
    stream = ShardStream(found, replace(SETTINGS, chunks=1), seed=0)
    epoch = [batch.points for batch in itertools.islice(stream, found.records)]
    assert len({points.numpy().tobytes() for points in epoch}) == found.records
    # known by what is in them, wherever they lie
    here = [str(written / NAME.search(shard.url)[0]) for shard in found.shards]  # type: ignore[index]
    assert found.identity == open_shards(here).identity
    assert (found.identity == open_shards(str(written)).identity) == (shards == 4)


@pytest.mark.parametrize(
    ("urls", "message"),
    [
        ("{0}/gone", r"gone: not a shard"),
        ("{0}/gone/", r"gone: not a shard"),
        ("{0}/gone/chunks-*.tar", r"there is no such shard"),
        ("{0}/gone/chunks-000000.tar", r"gone/shards\.json: .* cannot be read .*not finished"),
        ("{0}/chunks-000004.tar", r"chunks-000004\.tar: not in shards\.json"),
        ("{0}/chunks-{{000000..000004.tar", r"the braces cannot be read"),
        ("{0}/plan.json", r"plan\.json: not a shard"),
        ("???", r"data\.urls=\?\?\?: there is no such shard"),
        ([], r"data\.urls is empty"),
        ("pipe:exit 3 # chunks-000000.tar", r"shards\.json: .* cannot be read"),
        ("pipe:true # chunks-000000.tar", r"shards\.json: .* cannot be read"),
        ("nowhere:chunks-000000.tar", r"nowhere:shards\.json: .* cannot be read"),
        ("{1}/gone/chunks-000000.tar", r"gone/shards\.json: .* cannot be read"),
    ],
)
def test_wrong_urls(
    written: Path, urls: str | list[str], message: str, request: pytest.FixtureRequest
) -> None:
    if isinstance(urls, str):
        urls = place(urls, written, request)
    with pytest.raises(TFLabError, match=message):
        open_shards(urls)


@pytest.mark.parametrize(
    "damage",
    [
        lambda index: index.update(format=99),
        lambda index: index.pop("shards"),
        lambda index: index.pop("settings"),
        lambda index: index["shards"][0].update(name="../../etc/passwd"),
        lambda index: index["shards"][0].update(records=0),
        lambda index: index["shards"][0].update(records="many"),
        lambda index: index["settings"].update(images="many"),
        lambda index: index.update(shards=3),
    ],
)
def test_a_damaged_index(
    written: Path, tmp_path: Path, damage: Callable[[dict[str, object]], object]
) -> None:
    copied = shutil.copytree(written, tmp_path / "copied")
    path = copied / "shards.json"
    index = json.loads(path.read_text())
    damage(index)
    path.write_text(json.dumps(index))
    with pytest.raises(TFLabError, match=r"shards\.json: (damaged|shards of format 99)"):
        open_shards(str(copied))
    path.write_text("[]")
    with pytest.raises(TFLabError, match=r"shards\.json: damaged"):
        open_shards(str(copied))


def test_sets_drawn_in_different_ways(written: Path, box_scene: Path, tmp_path: Path) -> None:
    small_shards.write(tmp_path, sampler(box_scene, replace(SETTINGS, images=5)))
    with pytest.raises(TFLabError, match="drawn with"):
        open_shards([str(written), str(tmp_path)])

"""The site is the repository's pages, whichever folder they are in.

README.md is its first page, and CONTRIBUTING.md and CHANGELOG.md are pages, too. A link of any page
to another file of the repository (a result, a picture) is a link to a copy of that file in the
site. So links work where the repository is browsed and on the site, and ``--strict`` checks them.
The reference of the settings is what the commands' ``--help`` prints.
"""

from __future__ import annotations

import os
import posixpath
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
COMMANDS = (
    *("train", "prepare", "reconstruct", "check", "evaluate", "report", "runs", "pretrain"),
    *("pretrain_stereo", "view", "figures", "benchmark"),
)
SETTINGS = """# Settings

What `--help` of every command prints. With a choice beside it, as in
`python -m tf_lab.train data=captures --help`, the settings are those of the choice.
"""
LINK = re.compile(r"(\]\()([^)#:\s]+)((?:#[^)\s]*)?\))")  # [text](path#anchor), no address


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages from outside docs/ and whatever file pages link to."""
    root = Path(config.config_file_path).parent
    for source, uri in PAGES.items():
        files.append(File.generated(config, uri, abs_src_path=str(root / source)))
    files.append(File.generated(config, "settings.md", content=settings_page(root)))
    for page in list(files.documentation_pages()):
        if page.abs_src_path is None:
            continue
        for path in linked(page.content_string, source_of(page, root)):
            uri = place(path)
            if (root / path).is_file() and files.get_file_from_path(uri) is None:
                files.append(File.generated(config, uri, abs_src_path=str(root / path)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point the links at the places that files have on the site."""
    if page.file.abs_src_path is None:
        return markdown
    source = source_of(page.file, Path(config.config_file_path).parent)
    here = posixpath.dirname(page.file.src_uri)

    def moved(match: re.Match[str]) -> str:
        target = place(resolved(match[2], source))
        return match[1] + posixpath.relpath(target, here or ".") + match[3]

    return LINK.sub(moved, markdown)


def linked(markdown: str, source: str) -> list[str]:
    """The files that a page at ``source`` links to, from the root of the repository."""
    return [resolved(match[2], source) for match in LINK.finditer(markdown)]


def resolved(link: str, source: str) -> str:
    """A page's link, from the root of the repository."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(source), link))


def place(path: str) -> str:
    """Where a file of the repository is on the site."""
    return PAGES.get(path, path.removeprefix("docs/"))


def source_of(file: File, root: Path) -> str:
    """A page's path from the root of the repository."""
    assert file.abs_src_path is not None
    return Path(file.abs_src_path).relative_to(root).as_posix()


def settings_page(root: Path) -> str:
    """Every command's choices and settings, as ``--help`` has them."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        texts = list(pool.map(lambda command: help_of(command, root), COMMANDS))
    sections = [f"## {c}\n\n```text\n{t}```\n" for c, t in zip(COMMANDS, texts, strict=True)]
    return "\n".join([SETTINGS, *sections])


def help_of(command: str, root: Path) -> str:
    """What a command says of itself, wherever the site is built."""
    words = [sys.executable, "-m", f"tf_lab.{command}", "--help"]
    path = os.pathsep.join(filter(None, [str(root / "src"), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": path, "HOME": "~"}
    environment.pop("TF_LAB_CACHE", None)
    done = subprocess.run(words, env=environment, check=True, capture_output=True, text=True)
    return done.stdout

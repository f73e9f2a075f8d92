"""What is drawn on a page, without a browser."""

from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("viser", reason="needs pip install 'tf_lab[viewer]'")

from tf_lab.viewer.scene import Drawing


class Node:
    """A piece of the mesh, while another comes."""

    def __init__(self, drawing: Any) -> None:
        self.drawing, self.shown = drawing, True

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "visible":
            self.drawing._pieces[len(self.drawing._pieces)] = self
            self.shown = value
        else:
            super().__setattr__(name, value)


def test_pieces_may_come_while_the_mesh_is_hidden() -> None:
    drawing: Any = Drawing.__new__(Drawing)
    drawing._hidden, drawing._cameras, drawing.name = set(), {}, "/scene"
    drawing._pieces = {}
    drawing._pieces |= {i: Node(drawing) for i in range(3)}
    drawing.server = SimpleNamespace(scene=SimpleNamespace(get_handle_by_name={}.get))
    first = list(drawing._pieces.values())
    drawing.set_visible("mesh", False)
    assert [node.shown for node in first] == [False] * 3
    assert "mesh" in drawing._hidden

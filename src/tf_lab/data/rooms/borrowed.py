"""What others made that stands in training scenes: modelled furniture, photographs of surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tf_lab.data.rooms import models, photographs
from tf_lab.data.rooms.catalogue import Catalogue
from tf_lab.data.rooms.photographs import Photographs


@dataclass(frozen=True)
class Borrowed:
    """Catalogues of things that others made; None: all is ours."""

    furniture: Catalogue | None = None
    photographs: Photographs | None = None

    @property
    def identity(self) -> list[Any]:
        """What shapes scenes with them; nothing where there are none."""
        furniture = [] if self.furniture is None else [models.VERSION, self.furniture.digest]
        covers = self.photographs
        return furniture + (
            [] if covers is None else ["photographs", photographs.VERSION, covers.digest]
        )

    def attribution(self) -> str | None:
        """Whom images of the scenes have to name, if anybody."""
        named = [
            each.attribution() for each in (self.furniture, self.photographs) if each is not None
        ]
        return "\n".join(named) or None


NOTHING = Borrowed()

"""Data sources: where the scenes of the splits come from. One signature for all.

A source is a `DataSource` (see `tf_lab.data.sources.source`), made of its settings. It names the
scenes of "train", "val" and "test", makes those that are missing, and says by a digest what is in
them, so that results of other data are never taken for its own.
"""

from __future__ import annotations

from dataclasses import dataclass

from tf_lab.data.sources.settings import CapturesData, FlatsData, RoomsData, ScanNetData
from tf_lab.support.registry import Part, Registry


@dataclass(frozen=True)
class SourcePart(Part):
    """A data source by name; ``target`` is a `DataSource`."""


SOURCES: Registry[SourcePart] = Registry("data", "name")
_HERE = "tf_lab.data.sources"
for _part in (
    SourcePart("rooms", f"{_HERE}.embedded:RoomSource", RoomsData),
    SourcePart("flats", f"{_HERE}.embedded:FlatSource", FlatsData),
    SourcePart("captures", f"{_HERE}.captures:CaptureSource", CapturesData),
    SourcePart("scannet", f"{_HERE}.scannet:ScanNetSource", ScanNetData),
):
    SOURCES.add(_part)

__all__ = ["SOURCES", "SourcePart"]

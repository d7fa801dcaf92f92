"""The scans of a recording: one file each, and the system that shows them again as they came."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from twin_diagram.errors import ScenarioError, StationError
from twin_diagram.scenario import Lidar
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station.replay.reading import PICTURES, newest, read_table, rising
from twin_diagram.station.replay.recording_folder import SCANS, UNFINISHED, Manifest, scan_file


@dataclass(frozen=True)
class Scans:
    """A lidar's scans, which stay in their files.

    Attributes:
        folder: where they are.
        index: (S,) numbers in their names.
        capture: (S,) when each was taken [s].
        delivery: (S,) when each came to stand on the ports [s], rising.
        size: beams.
    """

    folder: Path
    index: npt.NDArray[np.int64]
    capture: Array
    delivery: Array
    size: int


def read_scans(folder: Path, manifest: Manifest, lidar: Lidar | None) -> Scans | None:
    """Return the scans of a recording; None where it has none, or the twin was told of no lidar.

    Args:
        folder: of the recording.
        manifest: its own.
        lidar: that the twin was told of.

    Raises:
        ScenarioError: the twin was told of another lidar.
        StationError: a scan is missing.
    """
    recorded = manifest.lidar
    if lidar is None or recorded is None:
        return None
    for name in ("name", "columns", "rows"):
        if getattr(lidar, name) != getattr(recorded, name):
            raise ScenarioError(f"twin.lidar.{name}", f"{getattr(lidar, name)}; recorded was {getattr(recorded, name)}")
    scans = folder / recorded.folder
    table = read_table(scans / SCANS, PICTURES, cut=folder.name == UNFINISHED)
    rising(scans / SCANS, table[:, 2])
    index = table[:, 0].astype(np.int64)
    for k in index:
        if not (scans / scan_file(k)).is_file():
            raise StationError(f"{scans / scan_file(k)}: missing from the recording")
    return Scans(scans, index, table[:, 1], table[:, 2], recorded.columns * recorded.rows)


class ScanPlayer(LeafSystem):
    """Shows recorded scans.

    .. pydrake_system::

        name: ScanPlayer
        output_ports:
        - ranges
        - scan_time

    As on any station; zeros and `NEVER` before the first. Each scan stands from its delivery to the next one's. A
    function of time alone; the scan that was read last is kept.
    """

    def __init__(self, scans: Scans) -> None:
        """`scans`: may be empty."""
        super().__init__()
        self._scans = scans
        self._kept: tuple[int, Array] = (-1, np.zeros(scans.size))  # a scan never changes, so that this is no state
        ticket = {self.time_ticket()}
        self.DeclareVectorOutputPort("ranges", scans.size, self._calc_ranges, ticket)
        self.DeclareVectorOutputPort("scan_time", 1, self._calc_time, ticket)

    def _calc_ranges(self, context: Context, output: BasicVector) -> None:
        k = newest(self._scans.delivery, context.get_time())
        if k < 0:
            output.SetFromVector(np.zeros(self._scans.size))
            return
        if self._kept[0] != k:
            self._kept = k, read_scan(self._scans.folder / scan_file(self._scans.index[k]), self._scans.size)
        output.SetFromVector(self._kept[1])

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        k = newest(self._scans.delivery, context.get_time())
        output[0] = self._scans.capture[k] if k >= 0 else NEVER


def read_scan(file: Path, size: int) -> Array:
    """Return the ranges (size,) of one scan [m].

    Raises:
        StationError: missing or damaged.
    """
    try:
        with np.load(io.BytesIO(file.read_bytes()), allow_pickle=False) as data:
            ranges = np.asarray(data["ranges"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise StationError(f"{file}: not a scan: {error}") from error
    if ranges.shape != (size,) or ranges.dtype != np.float64:
        raise StationError(f"{file}: holds {ranges.shape} numbers of type {ranges.dtype}; a scan has {size} of float64")
    return ranges

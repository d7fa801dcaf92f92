"""Unknown things of a folder of frames that become assets of a library, and of the tracker, as soon as they can."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from twin_diagram.assets import Asset
from twin_diagram.assets.building.from_mesh import AssetPlace
from twin_diagram.assets.building.growth_file import free_name, write_partial
from twin_diagram.errors import AssetError, TwinError
from twin_diagram.perception.things.growing import TUNING
from twin_diagram.runs.tracking.object_tracker import ObjectTracker
from twin_diagram.runtime import atomic_file


class GrownAssets:
    """Builds assets of what a tracker follows; frames wait for it, so that the same frames give the same assets.

    The library gets them when all frames were read: where one cannot be used, nothing is written.
    """

    def __init__(
        self,
        library: Path,
        tracker: ObjectTracker,
        assets: dict[str, Asset],
        numbers: dict[str, int],
        say: Callable[[str], None],
    ) -> None:
        """Begin to watch.

        Args:
            library: gets the assets.
            tracker: that follows unknown things.
            assets: by name; gets what grows.
            numbers: BOP numbers by name; a grown one gets the next.
            say: takes what happens.
        """
        self._library, self._tracker, self._assets = library, tracker, assets
        self._numbers, self._say = numbers, say
        self._failed: set[int] = set()
        self._built: list[str] = []
        self._aside = TemporaryDirectory()

    def poll(self, number: int) -> None:
        """Make assets of what was seen from enough sides by the frame of a number; they count from the next one on."""
        for identity, thing in sorted(self._tracker.growing.items()):
            if not thing.growth.ready or identity in self._failed:
                continue
            name = free_name(self._library, identity, self._assets)
            try:
                grown = thing.growth.grown(AssetPlace(name, self._aside.name))
                asset = Asset.load(grown.built.folder)
                self._tracker.take_in(identity, name, asset, grown.R_TO, grown.p_TO)
            except TwinError as error:
                self._failed.add(identity)
                self._say(f"frame {number}: an unknown thing stays unknown: {' '.join(str(error).split())}")
                continue
            self._assets[name] = asset
            self._built.append(name)
            self._numbers[name] = max(self._numbers.values(), default=0) + 1
            self._say(f"frame {number}: an unknown thing is {name} from now on, obj_id {self._numbers[name]}")

    def close(self) -> None:
        """Put what was built into the library, and of what stays partial what was seen, and nothing else.

        Raises:
            AssetError: another command has put an asset of that name there meanwhile; nothing is written.
        """
        for name in self._built:
            if (self._library / name).exists():
                raise AssetError(
                    f"--grow {self._library}: another command has put {name} there meanwhile; run again, or grow "
                    "into a folder of its own"
                )
        self._library.mkdir(parents=True, exist_ok=True)
        for name in self._built:
            hidden = atomic_file.make_aside(self._library.absolute() / name)
            try:
                shutil.copytree(Path(self._aside.name) / name, hidden, dirs_exist_ok=True)
                hidden.rename(self._library / name)
            finally:
                shutil.rmtree(hidden, ignore_errors=True)
        self._aside.cleanup()
        if not self._built and not self._tracker.growing:
            self._say(
                f"note: nothing has grown: no unknown thing is followed; one must cover {TUNING.fewest} of the pixels "
                "that are looked at: come nearer, or take finer pictures"
            )
        for identity, thing in sorted(self._tracker.growing.items()):
            part = thing.growth.partial()
            write_partial(self._library / f"unknown_{identity}.partial.npz", part)
            self._say(f"an unknown thing stays partial, seen from {100 * part.seen:.0f} % of its sides")

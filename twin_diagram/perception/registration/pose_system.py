"""The system that finds and follows the known objects."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, InputPort, LeafSystem

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.errors import TwinError
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.registration.colour_shift import ColourShift
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.image_look import ImageAnswer, ImageLook, ImageQuestion
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.rotation import from_quaternion
from twin_diagram.perception.registration.slots import SLOT_SIZE, Slot, measurement
from twin_diagram.perception.registration.tracking import step
from twin_diagram.perception.registration.view import Known
from twin_diagram.perception.registration.whole_image import ImageSettings, OtherMemory, introduced, sizes
from twin_diagram.perception.segmentation.segmentation_system import DeliveredImage, ImageParting
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.things.clusters import Placed
from twin_diagram.perception.things.memory import Life
from twin_diagram.runtime.timing import timed
from twin_diagram.runtime.work_beside import WorkBeside
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import MEASUREMENT_SIZE, NEVER, PoseMeasurement
from twin_diagram.signals.things import FURTHER_MEASUREMENT_SIZE, OWNER_SIZE


@dataclass(frozen=True)
class Tuning:
    """When the system updates, chosen by hand: any time after the delivery that is short beside an image's period."""

    after_delivery: float = 0.001
    """The update comes this long after an image is delivered [s]."""


TUNING = Tuning()


@dataclass(frozen=True)
class NewestLook:
    """What the newest image that was looked at showed.

    Attributes:
        time: when it was taken [s]; `NEVER` before the first.
        known: the objects that were found.
        shift: how far colours lie beside depth.
        params: tuning.
        smallest: points that make an object.
    """

    time: float
    known: list[Placed]
    shift: ColourShift
    params: scenario.Registration
    smallest: int

    def frame(self, segments: Segments) -> Frame:
        """Return the image ready for registration."""
        return Frame.of(segments, self.shift)


class IcpPoseEstimator(LeafSystem):
    """Poses of the library's objects, by coloured registration of their clouds to each image.

    .. pydrake_system::

        name: IcpPoseEstimator
        input_ports:
        - segments
        - picture (with `parting`)
        output_ports:
        - object_poses
        - further_poses (with slots)
        - things (with slots)
        - turned_away (with slots)

    Ports:
        segments: (`Segments`) of the newest image.
        picture: (`DeliveredImage`) the same as it was delivered: a process that works beside takes it apart, too.
        object_poses: (K · MEASUREMENT_SIZE) a `PoseMeasurement` per object, in the library's order: X_WO at the image's
            capture time, covariance, quality; quality 0 with the last pose where an object was not found in the image,
            time `NEVER` before the first image. Quality below 0 is less the share of the object's surface through which
            the image shows what is behind: it is not there any more.
        further_poses: (F · FURTHER_MEASUREMENT_SIZE) of further instances of the objects; see `signals.things`.
        things: (T · THING_SIZE) a packed `Thing` for each slot of an unknown thing.
        turned_away: (2) further instances and unknown things in the newest image for which no slot was free.

    Updated at k / rate + latency + 1 ms + ``perception.latency``, k = 0, 1, …: the poses are those of the image
    delivered just before, so they are as much older than it when they come out. All memory is discrete vector state.
    """

    def __init__(
        self,
        library: Mapping[str, Asset],
        camera: scenario.Camera,
        params: scenario.Registration,
        perception: scenario.Perception | None = None,
        slots: scenario.Slots | None = None,
        scene: scenario.SceneUpdater | None = None,
        parting: ImageParting | None = None,
    ) -> None:
        """Build the system.

        Args:
            library: assets by the object's name.
            camera: the twin's camera: rate and latency.
            params: tuning.
            perception: of it the smallest size of a segment and the stride.
            slots: for further instances and unknown things; None: each object is there once, all else is ignored, and
                colours are taken to lie on depth.
            scene: of it when what is not seen counts as stale and as lost.
            parting: what takes images apart, where that may be done beside; it has an effect with slots and a latency.
        """
        super().__init__()
        tuning = perception or scenario.Perception()
        self.names = tuple(library)
        """The objects, in the order of `object_poses`."""
        self._library = tuple(Known.of(ModelCloud.of(asset, params.model_points)) for asset in library.values())
        self._added: list[Known] = []
        self._params = params
        self._smallest = tuning.smallest
        none = Segments.empty(Pinhole.from_scenario(camera).straight, tuning.stride, tuning.table_height)
        self._input = self.DeclareAbstractInputPort("segments", AbstractValue.Make(none))
        self._picture = self._picture_port(parting) if tuning.latency > 0.0 and slots is not None else None
        count = len(library)
        empty = np.concatenate([measurement(Slot(), None, NEVER).pack() for _ in range(count)] or [np.zeros(0)])
        memory = np.concatenate([Slot().pack() for _ in range(count)] or [np.zeros(0)])
        self._memory = self.DeclareDiscreteState(memory)
        self._out = self.DeclareDiscreteState(empty)
        self._last = self.DeclareDiscreteState(np.array([NEVER]))
        self.DeclarePeriodicDiscreteUpdateEvent(
            1.0 / camera.rate, camera.latency + TUNING.after_delivery + tuning.latency, self._update
        )
        self.DeclareVectorOutputPort(
            "object_poses",
            count * MEASUREMENT_SIZE,
            self._calc_poses,
            prerequisites_of_calc={self.discrete_state_ticket(self._out)},
        )
        self._told: ImageSettings | None = None
        self._late = tuning.latency > 0.0
        self._looking: WorkBeside[ImageQuestion, ImageAnswer] | None = None
        if slots is not None:
            lives = scene or scenario.SceneUpdater()
            life = Life(lives.stale_after, lives.lost_after)
            self._told = ImageSettings(self._library, params, tuning.smallest, slots, life, camera.colour_std)
            self._look = ImageLook(self._told, parting)
            self._declare_beside(self._told)
            if self._late:
                self.DeclarePeriodicPublishEvent(1.0 / camera.rate, camera.latency + TUNING.after_delivery, self._ask)

    def check_slots(self) -> None:
        """Refuse, with a TwinError, assets that come later where there are no slots for them at all."""
        if self._told is None or not self._told.further:
            raise TwinError("the twin has no slots for further objects: twin.slots.instances leaves none")

    def add_asset(self, asset: Asset) -> int:
        """Take in an asset that came later; answer its number, which follows the library's. No Context uses it yet."""
        self._added.append(Known.of(ModelCloud.of(asset, self._params.model_points)))
        return len(self._library) + len(self._added) - 1

    def use_asset(self, context: Context, number: int, pose: Array | None = None) -> None:
        """Look for an asset that was added from the next image on, and follow it, in this Context.

        Args:
            context: this system's own, at rest: between two steps of a simulator.
            number: as `add_asset` gave it.
            pose: (7) X_WO now, where that is known; None: it is searched for.

        Raises:
            IndexError: there is no such asset.
            TwinError: no slot is free.
        """
        if self._told is None or not 0 <= number - len(self._library) < len(self._added):
            raise IndexError(f"asset {number}: {len(self._added)} were added, from {len(self._library)} on")
        slot = Slot()
        if pose is not None:
            slot = Slot(True, from_quaternion(pose[:4]), np.array(pose[4:]), np.zeros(6), context.get_time())
        state = context.get_mutable_discrete_state(int(self._beside))
        beside = OtherMemory.unpack(np.asarray(state.value()), self._told)
        state.SetFromVector(introduced(beside, number, slot).pack())

    def own_slots(self, context: Context) -> dict[int, int]:
        """Return the numbers of the added assets that a Context uses, by the identity of the first instance of each."""
        if self._told is None:
            return {}
        beside = OtherMemory.unpack(np.asarray(context.get_discrete_state(int(self._beside)).value()), self._told)
        return {one.identity: one.asset for one in beside.further if one.identity and one.own}

    def looked_at(self, context: Context) -> float:
        """Return when the newest image that was looked at was taken [s]; `context` is this system's."""
        return float(context.get_discrete_state(self._last).value()[0])

    def looked(self, context: Context) -> NewestLook:
        """Return what the newest image showed; `context` is this system's."""
        assert self._told is not None
        beside = OtherMemory.unpack(np.asarray(context.get_discrete_state(int(self._beside)).value()), self._told)
        measured = np.asarray(context.get_discrete_state(self._out).value()).reshape(-1, MEASUREMENT_SIZE)
        rows = list(enumerate(measured))
        size, _ = sizes(self._told)
        further = np.asarray(context.get_discrete_state(self._beside_out).value())[:size]
        rows += [(int(row[1]), row[OWNER_SIZE:]) for row in further.reshape(-1, FURTHER_MEASUREMENT_SIZE) if row[0] > 0]
        found = [(k, PoseMeasurement.unpack(row)) for k, row in rows]
        every = (*self._library, *self._added)
        known = [
            (every[k].model, from_quaternion(one.pose[:4]), np.array(one.pose[4:]))
            for k, one in found
            if one.quality > 0
        ]
        return NewestLook(self.looked_at(context), known, beside.shift, self._params, self._smallest)

    def _declare_beside(self, told: ImageSettings) -> None:
        """Declare memory and outputs of what there is beside the first instance of each object."""
        self._beside = self.DeclareDiscreteState(OtherMemory.empty(told).pack())
        further, things = sizes(told)
        ends = np.cumsum([0, further, things, 2])
        self._beside_out = self.DeclareDiscreteState(np.zeros(int(ends[-1])))
        for k, name in enumerate(("further_poses", "things", "turned_away")):
            part = slice(int(ends[k]), int(ends[k + 1]))

            def calc(context: Context, output: BasicVector, part: slice = part) -> None:
                output.SetFromVector(context.get_discrete_state(self._beside_out).value()[part])

            size, ticket = part.stop - part.start, self.discrete_state_ticket(self._beside_out)
            self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc={ticket})

    @contextmanager
    def looking_beside(self) -> Iterator[Callable[[], None]]:
        """Have images be taken in by a process of its own, where there is a latency, for as long as `with` lasts.

        Yields what waits until the process has begun.

        Without it, and once an asset was added, that is done when it is due, with the same result to the bit.
        """
        if self._told is None or not self._late:
            yield lambda: None
            return
        with WorkBeside[ImageQuestion, ImageAnswer](self._look, "looks for objects") as beside:
            self._looking = beside
            try:
                yield beside.wait
            finally:
                self._looking = None

    def _picture_port(self, parting: ImageParting | None) -> InputPort | None:
        """Declare the port of images as they were delivered; None where they cannot be taken apart beside."""
        if parting is None:
            return None
        joints, nothing = np.zeros(parting.robot.joint_count), np.zeros((0, 0))
        none = DeliveredImage(NEVER, nothing.astype(np.uint8), nothing.astype(np.float32), joints, joints, np.zeros(0))
        return self.DeclareAbstractInputPort("picture", AbstractValue.Make(none))

    def _new(self, context: Context, port: InputPort) -> Any:
        """Return the newest image; None where it was taken in before: it says nothing new."""
        image = cast(Any, port.Eval(context))
        last = float(context.get_discrete_state(self._last).value()[0])
        return None if image.time < 0.0 or image.time <= last else image

    def _question(self, context: Context, image: Segments | DeliveredImage) -> ImageQuestion:
        memory, beside = (np.array(context.get_discrete_state(i).value()) for i in (self._memory, self._beside))
        return ImageQuestion(memory, beside, image)

    @timed("IcpPoseEstimator")
    def _ask(self, context: Context) -> None:
        """Have an image be taken in before that is due; changes no result."""
        if self._looking is None or self._added:
            return
        image = self._new(context, self._picture or self._input)
        if image is not None:
            self._looking.ask(self._question(context, image))

    @timed("IcpPoseEstimator")
    def _update(self, context: Context, discrete: DiscreteValues) -> None:
        image = self._new(context, self._picture or self._input)
        if image is None:
            return
        if self._told is None:
            vector = context.get_discrete_state(self._memory).value()
            slots = [Slot.unpack(part) for part in vector.reshape(-1, SLOT_SIZE)]
            after, found, _ = step(self._library, slots, image, self._params, self._smallest)
            if after:
                discrete.get_mutable_vector(self._memory).SetFromVector(np.concatenate([slot.pack() for slot in after]))
                discrete.get_mutable_vector(self._out).SetFromVector(np.concatenate([one.pack() for one in found]))
        else:
            answer = None if self._looking is None else self._looking.answer(self._question(context, image))
            if answer is None:
                # Others may have had it taken apart here already.
                question = self._question(context, cast(Segments, self._input.Eval(context)))
                answer = self._look.answer(question, tuple(self._added))
            discrete.get_mutable_vector(self._memory).SetFromVector(answer.memory)
            discrete.get_mutable_vector(self._out).SetFromVector(answer.poses)
            discrete.get_mutable_vector(self._beside).SetFromVector(answer.beside)
            discrete.get_mutable_vector(self._beside_out).SetFromVector(answer.told)
        discrete.get_mutable_vector(self._last).SetFromVector([image.time])

    def _calc_poses(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(self._out).value())

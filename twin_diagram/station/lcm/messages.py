"""Between Drake's LCM messages and arrays: what each arm's messages call a signal, and with which sign."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt
from drake import (  # type: ignore[import-untyped]
    lcmt_header,
    lcmt_iiwa_command,
    lcmt_iiwa_status,
    lcmt_image,
    lcmt_image_array,
    lcmt_panda_command,
    lcmt_panda_status,
)

from twin_diagram.errors import StationError
from twin_diagram.logs.lcm_arm_status import Status, read_iiwa, read_panda
from twin_diagram.signals.arrays import Array
from twin_diagram.station.depth_units import Colour, Depth, whole_units


@dataclass(frozen=True)
class Protocol:
    """The messages of one kind of arm.

    Attributes:
        status_channel, command_channel: of the public driver.
        status_type, command_type: the messages.
        read_status: from a status message.
        write_command: from utime [µs], positions and torques (None: not commanded).
    """

    status_channel: str
    command_channel: str
    status_type: type
    command_type: type
    read_status: Callable[[Any], Status]
    write_command: Callable[[int, Array, Array | None], Any]


def _write_panda(utime: int, position: Array, torque: Array | None) -> lcmt_panda_command:
    message = lcmt_panda_command()
    message.utime = utime
    message.num_joint_position = len(position)
    message.joint_position = position.tolist()
    message.control_mode_expected = lcmt_panda_status.CONTROL_MODE_POSITION
    if torque is not None:
        message.num_joint_torque = len(torque)
        message.joint_torque = torque.tolist()
        message.control_mode_expected |= lcmt_panda_status.CONTROL_MODE_TORQUE
    return message


def _write_iiwa(utime: int, position: Array, torque: Array | None) -> lcmt_iiwa_command:
    message = lcmt_iiwa_command()
    message.utime = utime
    message.num_joints = len(position)
    message.joint_position = position.tolist()
    if torque is not None:
        message.num_torques = len(torque)
        message.joint_torque = torque.tolist()
    return message


PROTOCOLS: Final = {
    "panda": Protocol("PANDA_STATUS", "PANDA_COMMAND", lcmt_panda_status, lcmt_panda_command, read_panda, _write_panda),
    "iiwa": Protocol("IIWA_STATUS", "IIWA_COMMAND", lcmt_iiwa_status, lcmt_iiwa_command, read_iiwa, _write_iiwa),
}
"""By the scenario's ``lcm.arm``."""


_COLOUR: Final = {
    lcmt_image.PIXEL_FORMAT_RGB: (3, [0, 1, 2]),
    lcmt_image.PIXEL_FORMAT_BGR: (3, [2, 1, 0]),
    lcmt_image.PIXEL_FORMAT_RGBA: (4, [0, 1, 2]),
    lcmt_image.PIXEL_FORMAT_BGRA: (4, [2, 1, 0]),
}
"""Channels, and where red, green and blue are among them."""

_DEPTH_TYPES: Final = {lcmt_image.CHANNEL_TYPE_UINT16: np.uint16, lcmt_image.CHANNEL_TYPE_FLOAT32: np.float32}
"""Types of a depth image's numbers: whole units of `lcm.depth_unit`, or metres."""


def _pixels(image: lcmt_image, dtype: type, channels: int) -> npt.NDArray[Any]:
    """Return (H, W, channels) of an image, without its rows' padding."""
    data = bytes(image.data)
    if image.compression_method == lcmt_image.COMPRESSION_METHOD_ZLIB:
        try:
            data = zlib.decompress(data)
        except zlib.error as error:
            raise StationError(f"an image on the bus cannot be unpacked: {error}") from error
    elif image.compression_method != lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED:
        decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        if decoded is None or decoded.dtype != dtype:
            raise StationError("an image on the bus is neither a PNG nor a JPEG picture of the type that it says")
        decoded = decoded.reshape(decoded.shape[0], decoded.shape[1], -1)
        if decoded.shape[2] < min(channels, 3):
            raise StationError(f"an image on the bus has {decoded.shape[2]} channel where {channels} are told")
        order = [2, 1, 0, 3][: decoded.shape[2]] if decoded.shape[2] >= 3 else [0]
        return decoded[..., order]
    width = np.dtype(dtype).itemsize * channels
    stride = image.row_stride or image.width * width
    if stride < image.width * width or len(data) < image.height * stride:
        raise StationError(f"an image on the bus has {len(data)} bytes for {image.width}×{image.height} pixels")
    rows = np.frombuffer(data, np.uint8, image.height * stride).reshape(image.height, stride)
    swapped = np.dtype(dtype).newbyteorder(">" if image.bigendian else "<")
    wide = np.ascontiguousarray(rows[:, : image.width * width]).view(swapped)
    return wide.reshape(image.height, image.width, channels)


def read_images(message: lcmt_image_array, depth_unit: float) -> tuple[Colour | None, Depth | None]:
    """Return the first colour and the first depth image of a message.

    Args:
        message: depth in metres (float) or millimetres (16 bit), as Drake's own systems have it.
        depth_unit: depths are rounded to a whole number of these [m].

    Returns:
        Colour (H, W, 4), alpha 255, and depth (H, W) [m], 0 where there is none; None where the message has no such
        image.

    Raises:
        StationError: an image is damaged.
    """
    colour: Colour | None = None
    depth: Depth | None = None
    for image in message.images:
        if image.pixel_format in _COLOUR and colour is None and image.channel_type == lcmt_image.CHANNEL_TYPE_UINT8:
            channels, order = _COLOUR[image.pixel_format]
            raw = image.compression_method in (
                lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED,
                lcmt_image.COMPRESSION_METHOD_ZLIB,
            )
            pixels = _pixels(image, np.uint8, channels)[..., order if raw else [0, 1, 2]]
            colour = np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)])
        elif image.pixel_format == lcmt_image.PIXEL_FORMAT_DEPTH and depth is None:
            dtype = _DEPTH_TYPES.get(image.channel_type)
            if dtype is None:
                raise StationError(f"a depth image on the bus has channel type {image.channel_type}; 16 bit or float")
            metres = _pixels(image, dtype, 1)[..., 0].astype(np.float32)
            if dtype is np.uint16:
                metres = metres * np.float32(1e-3)
            good = np.isfinite(metres) & (metres > 0)
            depth = whole_units(np.where(good, metres, np.float32(0)), depth_unit)
    return colour, depth


def write_images(utime: int, frame: str, colour: Colour, depth: Depth) -> lcmt_image_array:
    """Return a message of one colour and one depth image, not compressed.

    Args:
        utime: capture time on the sender's clock [µs].
        frame: name of the camera.
        colour: (H, W, 4).
        depth: (H, W) [m].
    """
    message = lcmt_image_array()
    message.header = _header(utime, frame)
    kinds = (
        (colour, lcmt_image.PIXEL_FORMAT_RGBA, lcmt_image.CHANNEL_TYPE_UINT8),
        (depth, lcmt_image.PIXEL_FORMAT_DEPTH, lcmt_image.CHANNEL_TYPE_FLOAT32),
    )
    for pixels, pixel_format, channel_type in kinds:
        image = lcmt_image()
        image.header = _header(utime, frame)
        image.height, image.width = pixels.shape[:2]
        image.data = pixels.tobytes()
        image.size = len(image.data)
        image.row_stride = image.size // image.height
        image.pixel_format, image.channel_type = pixel_format, channel_type
        image.compression_method = lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED
        message.images.append(image)
    message.num_images = len(message.images)
    return message


def _header(utime: int, frame: str) -> lcmt_header:
    header = lcmt_header()
    header.utime, header.frame_name = utime, frame
    return header

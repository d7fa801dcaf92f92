"""Subscribes to a channel of Drake's messages, and leaves out what are none."""

from __future__ import annotations

import logging
import struct
from typing import Any

from pydrake.common.value import AbstractValue
from pydrake.systems.lcm import LcmInterfaceSystem, LcmSubscriberSystem, PySerializer

_NO_MESSAGE = (ValueError, struct.error, IndexError, OverflowError, MemoryError)
"""What decoding raises for bytes of another kind, or cut off."""


class LenientSerializer(PySerializer):
    """Reads messages of one type; bytes that are none are left out, and the message before them goes on to count.

    A status of no joints at all, as of a driver that has lost its arm, is none either.
    """

    def __init__(self, channel: str, lcm_type: type) -> None:
        """Read messages of `lcm_type` from `channel`, which the warning names."""
        super().__init__(lcm_type)
        self._channel, self._type, self._warned = channel, lcm_type, False

    def Deserialize(self, buffer: bytes, abstract_value: AbstractValue) -> None:
        """Put the message that `buffer` holds into `abstract_value`."""
        try:
            message = self._type.decode(buffer)  # type: ignore[attr-defined]
            if getattr(message, "num_joints", 1):
                abstract_value.set_value(message)
        except _NO_MESSAGE:
            if not self._warned:
                self._warned = True
                logging.getLogger("twin_diagram").warning(
                    "%s: %d bytes that are no %s are left out; is it another type, or another version of it?",
                    self._channel, len(buffer), self._type.__name__,
                )  # fmt: skip


def subscriber(channel: str, lcm_type: type, interface: LcmInterfaceSystem) -> Any:
    """Return a subscriber that no bytes on its channel can stop."""
    return LcmSubscriberSystem(channel, LenientSerializer(channel, lcm_type), interface)

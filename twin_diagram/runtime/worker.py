"""The process that works beside a running loop: `python -m twin_diagram.runtime.worker`.

It reads what answers and then questions from its standard input, and writes the answers to its standard output; before
these an empty message, which says that it has begun. It
lives no longer than the one that started it: when its standard input ends, so does it, whatever it is at.
"""

from __future__ import annotations

import os
import pickle
import queue
import struct
import threading
from typing import BinaryIO, Final

from twin_diagram.runtime.child_process import ORPHANED

LENGTH: Final = struct.Struct("<Q")
"""Goes before each message: how many bytes it has."""


def send(stream: BinaryIO, message: bytes) -> None:
    """Write one message."""
    stream.write(LENGTH.pack(len(message)))
    stream.write(message)
    stream.flush()


def receive(stream: BinaryIO) -> bytes:
    """Return the next message.

    Raises:
        EOFError: there is none.
    """
    head = stream.read(LENGTH.size)
    if len(head) < LENGTH.size:
        raise EOFError
    size = LENGTH.unpack(head)[0]
    message = stream.read(size)
    if len(message) < size:
        raise EOFError
    return message


def main() -> None:
    """Answer questions until there are no more."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what anything prints is no answer
    incoming: queue.Queue[bytes] = queue.Queue()
    threading.Thread(target=_read, args=(incoming,), daemon=True).start()
    answering = pickle.loads(incoming.get())
    if hasattr(answering, "warm_up"):
        answering.warm_up()
    send(answers, b"")
    while True:
        send(answers, pickle.dumps(answering.answer(pickle.loads(incoming.get())), protocol=pickle.HIGHEST_PROTOCOL))


def _read(incoming: queue.Queue[bytes]) -> None:
    stream = os.fdopen(os.dup(0), "rb")
    try:
        while True:
            incoming.put(receive(stream))
    except EOFError:
        os._exit(ORPHANED)


if __name__ == "__main__":
    main()

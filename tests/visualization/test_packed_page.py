"""A page of meshcat's is smaller once packed, and takes in the same messages in the same order."""

from __future__ import annotations

import base64
import re
import zlib

from pydrake.geometry import Box, Meshcat, MeshcatParams, Rgba

from twin_diagram.visualization.packed_page import packed

TAKEN = re.compile(r'take\("([^"]*)", (true|false)\);')
SENT = re.compile(r'fetch\("data:application/octet-binary;base64,([^"]*)"\)')


def test_the_same_messages_in_the_same_order() -> None:
    meshcat = Meshcat(MeshcatParams(host="localhost"))
    meshcat.SetObject("small", Box(1.0, 2.0, 3.0), Rgba(1.0, 0.0, 0.0))
    vertices = [[float(k % 7), float(k % 5), float(k % 3)] for k in range(3000)]
    meshcat.SetTriangleMesh("large", list(map(list, zip(*vertices, strict=True))), [[0, 1], [1, 2], [2, 3]])
    page = meshcat.StaticHtml()
    small = packed(page)
    sent = [base64.b64decode(data) for data in SENT.findall(page)]
    taken = [(base64.b64decode(data), short == "true") for data, short in TAKEN.findall(small)]
    assert [zlib.decompress(data) if short else data for data, short in taken] == sent
    assert any(short for _, short in taken), "the mesh at least"
    assert len(small) < len(page) and "then(res => res.arrayBuffer())\n    .then(buffer" in small
    assert page.split("fetch(", 1)[0][:1000] == small[:1000] and small.endswith(page[-200:])


def test_a_message_that_cannot_be_taken_in_keeps_none_after_it_out() -> None:
    """Each is taken in after the one before: where that failed for good, none would ever be."""
    meshcat = Meshcat(MeshcatParams(host="localhost"))
    meshcat.SetObject("one", Box(1.0, 2.0, 3.0), Rgba(1.0, 0.0, 0.0))
    taken_in = packed(meshcat.StaticHtml()).split("const take =")[1].split("};")[0]
    assert taken_in.rstrip().endswith(".catch(error => console.error(error));")


def test_another_page_stays_as_it_is() -> None:
    assert packed("<html>fetch('a')</html>") == "<html>fetch('a')</html>"

"""What is called a mesh and holds something else is refused in one line that says what to do."""

from __future__ import annotations

import gzip
import io
import re
import zipfile
from pathlib import Path

import pytest
import trimesh

from tests.assets.building.made_meshes import box
from twin_diagram import cli
from twin_diagram.assets.building.other_content import other_content
from twin_diagram.assets.building.source_mesh import read_source

TEXTS = {
    "obj": str(box(0.1, 0.06, 0.04).export(file_type="obj")),
    "stl": str(box(0.1, 0.06, 0.04).export(file_type="stl_ascii")),
    "ply": bytes(box(0.1, 0.06, 0.04).export(file_type="ply", encoding="ascii")).decode(),
}


def with_commas(text: str) -> str:
    head, end, body = text.partition("end_header")
    return head + end + re.sub(r"(\d)\.(\d)", r"\1,\2", body) if end else re.sub(r"(\d)\.(\d)", r"\1,\2", text)


def zipped(text: str) -> bytes:
    with zipfile.ZipFile(file := io.BytesIO(), "w") as archive:  # stored as it is, its lines can be read
        archive.writestr("mesh.obj", text)
    return file.getvalue()


CODES = ("utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-be")
POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"
OTHER = {
    **{f"{code}.{kind}": (text.encode(code), code[:6].upper()) for kind, text in TEXTS.items() for code in CODES},
    "remark.obj": (("# Тело\n" + TEXTS["obj"]).encode("utf-16"), "UTF-16; save it as UTF-8"),
    **{f"comma.{kind}": (with_commas(text).encode(), "decimal commas") for kind, text in TEXTS.items()},
    "mac.obj": (with_commas(TEXTS["obj"]).replace("\n", "\r").encode(), "decimal commas"),
    "late.obj": (b"v 0 0 0\nv 1 0 0 # not 2,5\nv 0 1 0,25\n", "(0,25); save it with decimal points"),
    "packed.obj": (gzip.compress(TEXTS["obj"].encode()), "gzip"),
    "packed.stl": (zipped(TEXTS["stl"]), "ZIP"),
    "stored.obj": (zipped(TEXTS["obj"]), "ZIP); unpack it"),
    **{f"pointer.{kind}": (POINTER, "git lfs pull") for kind in ("obj", "stl", "ply", "glb", "gltf", "dae")},
    **{f"page.{kind}": (b"\n<!DOCTYPE html><html>404</html>", "web page") for kind in ("obj", "stl", "glb", "dae")},
}


@pytest.mark.parametrize("name", OTHER)
def test_what_is_no_mesh_says_what_it_is(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file, (data, words) = tmp_path / f"größe {name}", OTHER[name]
    file.write_bytes(data)
    given = ["assets", "build", str(file), "--name", "it", "--library", str(tmp_path / "lib")]
    assert cli.main(given) == 2
    out, err = capfd.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith(f"error: {file}: ") and words in err
    assert not (tmp_path / "lib").exists()


def test_meshes_are_not_taken_for_something_else(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(2, 0.05)
    stl, ply = bytes(ball.export(file_type="stl")), bytes(ball.export(file_type="ply"))
    for head in (b"\xff\xfe" + 78 * b"\0", b"solid of 1,5 kg".ljust(80, b"\0"), 80 * b"\0", 80 * b" "):
        (tmp_path / "ball.stl").write_bytes(head + stl[80:])
        assert len(read_source(tmp_path / "ball.stl").parts[0].corners) == len(ball.faces)
    for suffix, data in ((".ply", ply), (".glb", bytes(ball.export(file_type="glb"))), (".obj", b"")):
        assert other_content(data, suffix) is None
    obj = "# of 1,5 kg\no part 1,5\nusemtl 2,0 mm\n" + TEXTS["obj"] + "v 1 2 3 # was 1,5\n"
    assert other_content(obj.encode(), ".obj") is None
    dae = '<?xml version="1.0" encoding="utf-16"?>'.encode("utf-16")
    assert other_content(dae, ".dae") is None

"""Compiled loops: kept on disk by what all kernels say, and only slower where nothing can be written."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numba
import numpy as np
import pytest

from twin_diagram.perception.registration import cloud_kernels
from twin_diagram.signals import compiled as subject


def total(numbers: np.ndarray) -> float:  # type: ignore[type-arg]
    """Sum in order."""
    result = 0.0
    for k in range(numbers.shape[0]):
        result += numbers[k]
    return result


def test_what_is_kept_goes_by_all_kernels_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "package"
    (package / "room").mkdir(parents=True)
    (package / "room" / "some_kernels.py").write_text("a = 1\n")
    monkeypatch.setattr(subject, "PACKAGE", package)
    found = []
    for text in ("a = 1\n", "a = 2\n", "a = 1\n"):
        (package / "room" / "some_kernels.py").write_text(text)
        (package / "room" / "other.py").write_text(text)
        subject.kept_in.cache_clear()
        found.append(subject.kept_in())
    subject.kept_in.cache_clear()
    assert found[0] == found[2] != found[1]
    assert found[0].parent == package / "__pycache__"


def test_kernels_that_nobody_used_for_long_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each version leaves its own; what is in use, of whatever version, and what is none of them stay."""
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    place = tmp_path / "twin_diagram"
    for name, age in (("kernels-old", 1.01), ("kernels-young", 0.99), ("records", 2.0)):
        (place / name / "below").mkdir(parents=True)
        then = time.time() - age * subject.FORGOTTEN
        os.utime(place / name, (then, then))
    subject.kept_in.cache_clear()
    mine = subject.kept_in()
    subject.kept_in.cache_clear()
    assert sorted(entry.name for entry in place.iterdir()) == sorted([mine.name, "kernels-young", "records"])
    os.utime(mine, (0.0, 0.0))
    assert subject.kept_in() == mine and time.time() - mine.stat().st_mtime < 60.0
    subject.kept_in.cache_clear()


def test_in_a_package_that_cannot_be_written_to_the_users_cache_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    subject.kept_in.cache_clear()
    assert subject.kept_in().parent == tmp_path / "twin_diagram"
    subject.kept_in.cache_clear()


def test_where_nothing_can_be_kept_it_is_compiled_all_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setattr(subject, "kept_in", lambda: blocked / "below")
    before = numba.config.CACHE_DIR
    assert subject.compiled(total)(np.arange(5.0)) == 10.0
    assert numba.config.CACHE_DIR == before


def test_a_compiled_loop_says_what_it_says_uncompiled() -> None:
    rng = np.random.default_rng(7)
    R, p = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3)
    point, one, other = rng.normal(size=3), np.empty(3), np.empty(3)
    cloud_kernels.into(point, R, p, one)
    getattr(cloud_kernels.into, "py_func", cloud_kernels.into)(point, R, p, other)
    np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(one, (point - p) @ R, atol=1e-14)


def double(source: np.ndarray, target: np.ndarray) -> None:  # type: ignore[type-arg]
    """Write twice a row."""
    for i in range(len(source)):
        target[i] = 2.0 * source[i]


def test_rows_of_arrays_are_not_counted_where_none_is_made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Counting rows, when made and when left, is a third of the time of a loop over points."""
    source, counted = np.random.default_rng(3).normal(size=(5, 3)), []
    for k, compile_it in enumerate((subject.compiled, subject.compiled_in_place)):
        monkeypatch.setattr(subject, "kept_in", lambda k=k: tmp_path / str(k))
        inner = compile_it(double)

        def each(source: np.ndarray, target: np.ndarray) -> None:  # type: ignore[type-arg]
            for k in range(len(source)):
                inner(source[k], target[k])  # noqa: B023

        target = np.zeros_like(source)
        outer = compile_it(each)
        outer(source, target)
        np.testing.assert_array_equal(target, 2.0 * source)
        counted.append(any("NRT_incref" in text for text in outer.inspect_llvm().values()))  # type: ignore[attr-defined]
    assert counted == [True, False]

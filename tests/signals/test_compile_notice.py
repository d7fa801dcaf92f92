"""What is compiled for long says so, once and on stderr."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from numba.core import event

from twin_diagram.signals import compile_notice
from twin_diagram.signals.compile_notice import SAID, CompileNotice


def test_long_compiling_is_told_once(capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    notice = CompileNotice(clock=lambda: now[0])
    loop = event.Event("numba:compile", event.EventStatus.START)
    for _ in range(3):  # each holds another, and takes two seconds
        for elapsed in (0.5, 0.5):
            notice.on_start(loop)
            now[0] += elapsed
        for elapsed in (0.5, 0.5):
            now[0] += elapsed
            notice.on_end(loop)
        now[0] += 100.0  # what lies between is not compiling
        assert capsys.readouterr().err == ({2.0: "", 104.0: SAID + "\n"}.get(now[0] - 100.0, ""))


def test_numba_tells_of_what_it_compiles(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(compile_notice, "PATIENCE", 0.0)
    notice = CompileNotice()
    event.register("numba:compile", notice)
    try:
        assert numba.njit(lambda x: x + 1.0)(np.float64(1.0)) == 2.0
    finally:
        event.unregister("numba:compile", notice)
    assert SAID in capsys.readouterr().err

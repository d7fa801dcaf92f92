"""Signals: the first closes, after the step that is taken or in it if that takes long; the second ends at once."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import pytest
from numba.core import codegen

from twin_diagram import cli
from twin_diagram.runtime import stopping
from twin_diagram.runtime.stopping import Stopped, stoppable

HANDLED = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)


def send(number: int) -> None:
    os.kill(os.getpid(), number)
    time.sleep(0.01)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_stops_and_the_handlers_are_given_back(number: int, status: int) -> None:
    before = [signal.getsignal(each) for each in HANDLED]
    with pytest.raises(Stopped) as stop, stoppable():
        send(number)
    assert stop.value.status == status and isinstance(stop.value, KeyboardInterrupt)
    assert [signal.getsignal(each) for each in HANDLED] == before
    stopping.check()  # nothing of it is left


@pytest.mark.parametrize("made", [ImportError("initialization failed"), SystemError("a result with an exception set")])
def test_a_stop_that_a_module_in_c_makes_into_another_error_is_a_stop(made: Exception) -> None:
    with pytest.raises(Stopped), stoppable():
        try:
            send(signal.SIGINT)
        except KeyboardInterrupt:
            raise made from None
    with pytest.raises(type(made)), stoppable():  # without a signal it stays what it is
        raise made


class Swallowing(logging.Handler):
    """A log that goes on whatever is raised, as Drake's does: the stop came seven seconds late."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            send(signal.SIGINT)
            time.sleep(0.1)
        except BaseException:
            record.msg = "swallowed"


def test_a_log_cannot_swallow_a_stop() -> None:
    logger, handler = logging.getLogger("twin_diagram.tests"), Swallowing()
    logger.addHandler(handler)
    try:
        with pytest.raises(Stopped), stoppable():
            logger.warning("a line")
            time.sleep(1.0)
    finally:
        logger.removeHandler(handler)


def test_a_stop_is_not_lost_where_llvm_calls_back() -> None:
    """A run went on after Ctrl-C where it came while a compiled loop was being stored."""
    llvm = codegen.ll
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    module = llvm.parse_assembly("define i32 @one() { ret i32 1 }")
    engine = llvm.create_mcjit_compiler(module, llvm.Target.from_default_triple().create_target_machine(jit=True))
    engine.set_object_cache(lambda module, data: send(signal.SIGINT), lambda module: None)
    with pytest.raises(Stopped), stoppable():
        engine.finalize_object()
        time.sleep(1.0)


def test_pydrake_is_imported_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """It printed forty lines where it was stopped meanwhile."""
    spec = SimpleNamespace(_initializing=True)
    monkeypatch.setitem(sys.modules, "pydrake", SimpleNamespace(__spec__=spec))  # type: ignore[arg-type]
    done = False
    with pytest.raises(Stopped), stoppable():
        send(signal.SIGINT)
        time.sleep(0.1)
        spec._initializing, done = False, True
        time.sleep(1.0)
    assert done


def test_a_step_is_taken_whole() -> None:
    taken = []
    with pytest.raises(Stopped), stoppable(), stopping.steps():
        for step in range(3):
            if step == 1:
                send(signal.SIGINT)
            taken.append(step)
            stopping.check()
    assert taken == [0, 1]


def test_a_step_that_takes_too_long_is_broken_off() -> None:
    with pytest.raises(Stopped), stoppable(), stopping.steps():
        send(signal.SIGTERM)
        time.sleep(20.0 * stopping.TUNING.patience)
        pytest.fail("it was waited for")


def test_what_is_closed_after_a_step_is_not_broken_off() -> None:
    closed = False
    with pytest.raises(Stopped), stoppable():
        try:
            with stopping.steps():
                send(signal.SIGINT)
                stopping.check()
        finally:
            time.sleep(1.2 * stopping.TUNING.patience)
            closed = True
    assert closed


def test_elsewhere_than_in_the_main_thread_nothing_changes() -> None:
    before = [signal.getsignal(each) for each in HANDLED]
    seen = []

    def work() -> None:
        with stoppable():
            seen.extend(signal.getsignal(each) for each in HANDLED)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == before


@pytest.mark.parametrize(("first", "second", "status"), [("INT", "TERM", 143), ("TERM", "INT", 130)])
def test_the_second_ends_at_once(first: str, second: str, status: int) -> None:
    script = f"""if True:
        import os, signal, time
        from twin_diagram.runtime.stopping import stoppable
        with stoppable():
            try:
                os.kill(os.getpid(), signal.SIG{first})
                time.sleep(5)
            finally:
                os.kill(os.getpid(), signal.SIG{second})
                time.sleep(5)
                print("closed")
    """
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (status, "", "")


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_command_says_so(
    number: int, status: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cli, "_gap", lambda arguments: send(number))
    assert cli.main(["gap", "--model", "m", "--fit", "f", "--holdout", "h", "--out", "o"]) == status
    assert capsys.readouterr().err == "stopped\n"


def test_closing_lets_steps_pass_for_as_long_as_it_may_take() -> None:
    closed = []
    with pytest.raises(Stopped) as stop, stoppable():
        try:
            with stopping.steps():
                send(signal.SIGTERM)
                stopping.check()
        except Stopped:
            with stopping.closing(0.2):
                for _ in range(100):
                    time.sleep(0.01)
                    stopping.check()
                    closed.append(True)
    assert 5 < len(closed) < 40 and stop.value.status == 143
    stopping.check()  # nothing of it is left

"""What all tests share: one thread per process, repeatable hypothesis, the folder of measured data."""

from __future__ import annotations

import gc
import os
from pathlib import Path

# Set before numpy, Open3D and OpenCV are imported: small matrices run slower on many threads, and the tests themselves
# run in several processes.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
os.environ.setdefault("MPLBACKEND", "Agg")

import pytest  # noqa: E402
from hypothesis import HealthCheck, settings  # noqa: E402

from twin_diagram.signals import compile_notice  # noqa: E402

# Which test meets loops that are not compiled yet is chance: in the tests' own processes nobody tells of it.
compile_notice.install = lambda: None

settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    database=None,
    print_blob=False,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("repeatable")


@pytest.hookimpl(trylast=True)
def pytest_collection_finish(session: pytest.Session) -> None:
    """Keep the collector of garbage off what stays until the end: modules and some thousand tests."""
    gc.collect()
    gc.freeze()
    # Hypothesis listens to each collection, too; a tenth of them finds what is to be found.
    gc.set_threshold(7000, 10, 10)


CHECKOUT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of measured data and independent models; tests that use it skip where it is absent."""
    given = os.environ.get("TWIN_DIAGRAM_DATA")
    folder = Path(given) if given else CHECKOUT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no data folder at {folder}; set TWIN_DIAGRAM_DATA to its path")
    return folder


@pytest.fixture(scope="session")
def egl() -> None:
    """For tests that render: they skip where the renderer's system library is absent."""
    from twin_diagram.native import NativeLibraryError, require_egl

    try:
        require_egl()
    except NativeLibraryError as error:
        pytest.skip(str(error))

from __future__ import annotations

import pickle

import pytest

from twin_diagram.errors import LogError, ScenarioError, TwinError
from twin_diagram.native import NativeLibraryError


@pytest.mark.parametrize(
    "error",
    [TwinError("a"), LogError("line 3"), ScenarioError("twin.home", "too short"), NativeLibraryError(("x.so",))],
)
def test_errors_cross_process_borders(error: TwinError) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)

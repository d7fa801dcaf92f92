"""Unknown things that are seen from enough sides become assets of the running twin.

`Grower` is asked between two steps of a simulator; the asset is built in a process of its own.
"""

from twin_diagram.twin.growing.build_process import BuildOutcome, BuildProcess
from twin_diagram.twin.growing.grower import Grower

__all__ = ["BuildOutcome", "BuildProcess", "Grower"]

"""What a ray met on its way through a tree: what every kernel returns, and every simulation."""

from __future__ import annotations

from typing import Any, NamedTuple


class Visits(NamedTuple):
    """A column per quantity, an entry per ray: Dr.Jit arrays from a kernel, or NumPy's.

    Attributes
    ----------
    t : Float, (R,) float32
        Distance of the closest hit in the kernel's unit; infinite for a miss.
    triangle : UInt32, (R,) uint32 or int32
        Its id; 2**32 - 1, or -1, for a miss.
    inner, leaves, tests : UInt32, (R,) uint32
        Inner nodes visited (all child boxes tested), leaves visited, triangles tested; zero
        unless counted.
    boxes : UInt32, (R,) uint32, optional
        Child boxes tested; None where they are two per inner node.
    """

    t: Any
    triangle: Any
    inner: Any
    leaves: Any
    tests: Any
    boxes: Any = None

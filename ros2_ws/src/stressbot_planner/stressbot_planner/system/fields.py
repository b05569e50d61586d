"""Fields of dataclasses that are given as one thing and held as another, in the eyes of a type checker.

`__post_init__` turns the one into the other; at run time these are just names of what is held.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    class FrozenArray:
        """Given as anything that `numpy.array` takes, held as a read-only array."""

        def __get__(self, instance: object, owner: type) -> np.ndarray: ...
        def __set__(self, instance: object, value: ArrayLike) -> None: ...

    class Seconds:
        """Given as seconds, or None for the usual ones; held as seconds."""

        def __get__(self, instance: object, owner: type) -> float: ...
        def __set__(self, instance: object, value: float | None) -> None: ...

else:
    FrozenArray = np.ndarray
    Seconds = float

ONE: Any = 1.0
FREE: Any = float("nan")
NO_ENTRIES: Any = ()
USUAL: Any = None
"""Defaults of such fields, of a type that no checker holds against them."""

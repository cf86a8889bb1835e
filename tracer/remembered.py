"""Arrays that are known again, so that what was found out about them need not be found out each time."""

import weakref
from collections.abc import Iterable, Sequence
from typing import Any

from numpy.typing import NDArray


class Remembered:
    """Arrays that were looked at before, known again by identity.

    None of them is kept alive.

    Parameters
    ----------
    arrays
        Whose memory, dtype and shape stay what they are.
    """

    def __init__(self, arrays: Iterable[NDArray[Any]]) -> None:
        self._references = [weakref.ref(array) for array in arrays]

    def are(self, arrays: Sequence[NDArray[Any]]) -> bool:
        """Tell whether these are the same arrays, in the same order."""
        known = self._references
        return len(known) == len(arrays) and all(
            reference() is array for reference, array in zip(known, arrays, strict=True)
        )

"""What is wrong with a scene: faults with JSON pointers (RFC 6901), and the one error that carries them.

Invariant: a pointer resolves in the document, or names a member that is missing from an object (or array) that
resolves. Texts never hold lone surrogates, so that they can always be encoded as UTF-8.
"""

import difflib
import itertools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from pydantic_core import PydanticCustomError

from tracer.scene.limits import MAX_FAULTS

FAULTS_ERROR_TYPE = "scene_faults"
"""Type of the pydantic error by which a validator of this package hands over several faults at once."""


class Fault(NamedTuple):
    """One thing that is wrong in a scene document.

    Attributes
    ----------
    pointer : str
        JSON pointer (RFC 6901) from the document's root; "" is the whole document.
    message : str
        What was wrong.
    expected : str
        What would be right.

    """

    pointer: str
    message: str
    expected: str

    def below(self, prefix: str) -> "Fault":
        """Give the same fault with `prefix` put before its pointer."""
        return Fault(prefix + self.pointer, self.message, self.expected)


class SceneError(ValueError):
    """The scene document is not valid; `faults` tells every reason.

    Attributes
    ----------
    faults : tuple[Fault, ...]
        At least one fault, ordered by their place in the document's tables.

    """

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults: tuple[Fault, ...] = tuple(faults)
        lines = [
            f"{fault.pointer or '(document)'}: {fault.message}; expected {fault.expected}" for fault in self.faults
        ]
        super().__init__("the scene is not valid:\n" + "\n".join(lines))

    def __reduce__(self) -> tuple[type["SceneError"], tuple[tuple[Fault, ...]]]:
        """Pickle by the faults, as errors travel between processes."""
        return SceneError, (self.faults,)


def pointer_of(*tokens: str | int) -> str:
    """JSON pointer of a path of member names and indices.

    Examples
    --------
    >>> pointer_of("materials", "a/b", "kd", 0)
    '/materials/a~1b/kd/0'

    """
    return "".join("/" + str(token).replace("~", "~0").replace("/", "~1") for token in tokens)


def tokens_of(pointer: str) -> list[str]:
    """Member names and indices (as text) of a JSON pointer; the inverse of `pointer_of`."""
    return [token.replace("~1", "/").replace("~0", "~") for token in pointer.split("/")[1:]]


def is_text(value: str) -> bool:
    """Whether a string can be encoded as UTF-8, that is, holds no lone surrogate."""
    if value.isascii():
        return True
    try:
        value.encode()
    except UnicodeEncodeError:
        return False
    return True


def quoted(text: str) -> str:
    """Put a text in quotes, cut to 40 characters and always fit for UTF-8."""
    short = text if len(text) <= 40 else text[:37] + "..."
    return '"' + short.encode("utf-8", "backslashreplace").decode() + '"'


def shown(value: object) -> str:
    """Name any value shortly, for messages: type for containers, the value itself for scalars."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f"the text {quoted(value)}"
    if isinstance(value, float) and not math.isfinite(value):
        return "not a finite float64 number"
    if isinstance(value, int) and abs(value) >= 10**20:
        return f"a whole number of {len(str(abs(value)))} digits" if abs(value) < 10**1000 else "a huge whole number"
    if isinstance(value, int | float):
        return f"{value!r}"
    if isinstance(value, dict):
        return "an object"
    if isinstance(value, list | tuple):
        return f"an array of {len(value)} items"
    return f"a {type(value).__name__}"


def one_of(names: Iterable[str]) -> str:
    """Text that lists what may stand: `one of "a", "b"`; long lists are cut."""
    listed = sorted(names)
    if not listed:
        return "nothing: none is defined"
    text = ", ".join(quoted(name) for name in listed[:24])
    if len(listed) > 24:
        text += f" and {len(listed) - 24} more"
    return text if len(listed) == 1 else "one of " + text


def closest(name: str, names: Iterable[str]) -> str:
    """` (did you mean "x"?)` when a name comes close, else an empty text."""
    close = difflib.get_close_matches(name[:64], list(names)[:1000], n=1)
    return f" (did you mean {quoted(close[0])}?)" if close else ""


def faults_error(faults: Sequence[Fault]) -> PydanticCustomError:
    """Error to raise in a pydantic validator; pointers are relative to the validated value."""
    text = "; ".join(f"{fault.pointer} {fault.message}".strip() for fault in faults)
    return PydanticCustomError(FAULTS_ERROR_TYPE, "{text}", {"text": text, "faults": tuple(faults)})


def merged(*sources: Iterable[Fault]) -> tuple[Fault, ...]:
    """Faults of all sources without repetitions, cut to `MAX_FAULTS` of which the last one tells of the rest.

    Sources are asked for no more than is kept, since a hint at what was meant costs up to 4 ms a fault.
    """
    kept = dict.fromkeys(fault for source in sources for fault in itertools.islice(source, MAX_FAULTS))
    if len(kept) < MAX_FAULTS:
        return tuple(kept)
    rest = Fault("", "has more faults than these", "fewer: mend the ones above first")
    return (*itertools.islice(kept, MAX_FAULTS - 1), rest)

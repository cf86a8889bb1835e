"""JSON text, or a mapping from elsewhere, to plain values that are safe to validate.

Invariant: what comes out consists of dict (text keys), list, str, int, float, bool and None only, holds no NaN, no
infinity, no number beyond float64, no lone surrogate, no cycle, and nests at most `MAX_DEPTH` levels; where the input
had one, a fault tells the place and a harmless value stands there.
"""

import json
import math
from collections.abc import Mapping
from itertools import chain
from typing import Any

from tracer.scene.faults import Fault, SceneError, is_text, pointer_of, shown
from tracer.scene.limits import (
    MAX_CONTAINERS,
    MAX_DEPTH,
    MAX_FILE_NAME_LENGTH,
    MAX_ITEMS,
    MAX_NODES,
    MAX_ROW_FAULTS,
    MAX_TEXT_BYTES,
)

_FINITE = "a finite number that float64 can hold (at most about 1.8e308)"
_MAX_INT_DIGITS = 400  # float64 ends at 309 digits; longer ones need no exact value, and int() refuses 4,300


class _Repeated(dict[str, Any]):
    """A JSON object in which a key stood twice; the last one counts, and `repeated` names the keys."""

    repeated: tuple[str, ...] = ()


def _members(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Make a dict of the members of one JSON object, noting repeated keys."""
    members = dict(pairs)
    if len(members) == len(pairs):
        return members
    seen: set[str] = set()
    marked = _Repeated(members)
    marked.repeated = tuple({key: None for key, _ in pairs if key in seen or seen.add(key)})  # type: ignore[func-returns-value]
    return marked


def _whole_number(digits: str) -> int | float:
    """Whole number of a literal; one far beyond float64 becomes an infinity, which is told as a fault later."""
    return int(digits) if len(digits) <= _MAX_INT_DIGITS else math.inf


def load_json(data: bytes | str) -> object:
    """Parse JSON text; NaN, infinities and repeated keys are kept for `plain` to tell.

    Parameters
    ----------
    data : bytes or str
        JSON text; bytes are UTF-8, with or without a byte order mark.

    Raises
    ------
    SceneError
        When the text is too long, not UTF-8, or not JSON.

    """
    if len(data) > MAX_TEXT_BYTES:
        raise _text_error(f"is {len(data)} bytes long", f"at most {MAX_TEXT_BYTES} bytes; put large meshes into assets")
    if isinstance(data, str):
        text = data.removeprefix("\ufeff")
    else:
        try:
            text = bytes(data).decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise _text_error(f"is not UTF-8: {error.reason} at byte {error.start}", "JSON text in UTF-8") from None
    if text.count("[") + text.count("{") > MAX_CONTAINERS:
        raise _text_error(f"has more than {MAX_CONTAINERS} arrays and objects", "fewer; put large meshes into assets")
    if text.count(",") > MAX_ITEMS:
        raise _text_error(f"has more than {MAX_ITEMS} values", "fewer; put large meshes into assets")
    try:
        try:
            return json.loads(text, object_pairs_hook=_members)
        except json.JSONDecodeError:
            raise
        except (
            ValueError
        ):  # int() refuses more than 4,300 digits; a hook costs 0.4 s for 200,000 triangles, so only then
            return json.loads(text, object_pairs_hook=_members, parse_int=_whole_number)
    except json.JSONDecodeError as error:
        place = f"line {error.lineno}, column {error.colno}"
        raise _text_error(f"is not JSON: {error.msg} at {place}", "one JSON object") from None
    except RecursionError:
        raise _text_error(f"nests deeper than {MAX_DEPTH} levels", f"at most {MAX_DEPTH} levels") from None


def _text_error(message: str, expected: str) -> SceneError:
    return SceneError([Fault("", message, expected)])


class _Cleaner:
    """One walk over a value that builds its plain copy and collects faults."""

    def __init__(self) -> None:
        self.faults: list[Fault] = []
        self.n_nodes = 0

    def clean(self, value: object, pointer: str, depth: int) -> Any:
        """Plain copy of `value`, which is at `pointer`, inside `depth` containers."""
        self.n_nodes += 1
        if self.n_nodes > MAX_NODES:
            message = f"has more than {MAX_NODES} values outside arrays of numbers"
            raise SceneError([*self.faults, Fault("", message, "fewer objects, materials and names")])
        if value is None or isinstance(value, bool):
            return value
        if isinstance(value, str):
            return self._text(value, pointer)
        if isinstance(value, int | float):
            return self._number(value, pointer)
        if not isinstance(value, Mapping | list | tuple):
            self.faults.append(Fault(pointer, f"is {shown(value)}", "a JSON value"))
            return None
        if depth >= MAX_DEPTH:
            self.faults.append(Fault(pointer, f"nests deeper than {MAX_DEPTH} levels", f"at most {MAX_DEPTH} levels"))
            return None
        if isinstance(value, Mapping):
            return self._object(value, pointer, depth)
        return self._array(value, pointer, depth)

    def _text(self, value: str, pointer: str) -> str:
        if is_text(value):
            return str(value)
        self.faults.append(Fault(pointer, "holds a lone surrogate, which UTF-8 cannot encode", "Unicode text"))
        return value.encode("utf-8", "replace").decode()

    def _number(self, value: float, pointer: str) -> int | float:
        try:
            finite = math.isfinite(value)
        except OverflowError:  # an int beyond float64
            finite = False
        if finite:
            return int(value) if isinstance(value, int) else float(value)
        self.faults.append(Fault(pointer, f"is {_not_finite(value)}", _FINITE))
        return 1.0

    def _object(self, value: Mapping[Any, Any], pointer: str, depth: int) -> dict[str, Any]:
        for key in getattr(value, "repeated", ()):
            place = pointer + pointer_of(key) if is_text(key) and len(key) <= MAX_FILE_NAME_LENGTH else pointer
            self.faults.append(Fault(place, "stands twice in its object", "each key once"))
        members: dict[str, Any] = {}
        for key, member in value.items():
            if not isinstance(key, str) or not is_text(key):
                message = f"has the key {shown(key)}, which is no text that UTF-8 can encode"
                self.faults.append(Fault(pointer, message, "keys of Unicode text"))
                continue
            if len(key) > MAX_FILE_NAME_LENGTH:  # else each fault below would repeat megabytes
                message = f"has a key of {len(key)} characters"
                self.faults.append(Fault(pointer, message, f"keys of at most {MAX_FILE_NAME_LENGTH} characters"))
                continue
            members[key] = self.clean(member, pointer + pointer_of(key), depth + 1)
        return members

    def _array(self, value: list[Any] | tuple[Any, ...], pointer: str, depth: int) -> list[Any]:
        kinds = set(map(type, value))
        if kinds <= {int, float}:
            if _all_finite(value):
                return list(value)
            return self._numbers(value, pointer)
        if kinds == {list} and depth + 1 < MAX_DEPTH:
            flat = list(chain.from_iterable(value))
            # Rows of finite numbers, as those of a mesh: nothing to change, and one pass over all at C speed.
            if set(map(type, flat)) <= {int, float} and _all_finite(flat):
                return list(value)
        return [self.clean(item, f"{pointer}/{index}", depth + 1) for index, item in enumerate(value)]

    def _numbers(self, value: list[Any] | tuple[Any, ...], pointer: str) -> list[Any]:
        """Array of numbers of which some are not finite: the first of these are told."""
        bad = [index for index, number in enumerate(value) if not _all_finite((number,))]
        for index in bad[:MAX_ROW_FAULTS]:
            self.faults.append(Fault(f"{pointer}/{index}", f"is {_not_finite(value[index])}", _FINITE))
        copy = list(value)
        for index in bad:
            copy[index] = 1.0
        return copy


def _all_finite(numbers: list[Any] | tuple[Any, ...]) -> bool:
    """Whether all numbers are finite and within float64."""
    try:
        return all(map(math.isfinite, numbers))
    except OverflowError:  # an int beyond float64
        return False


def _not_finite(value: float) -> str:
    if isinstance(value, float) and math.isnan(value):
        return "NaN"
    return "infinite, or beyond what float64 can hold"


def plain(value: object) -> tuple[Any, list[Fault]]:
    """Plain copy of a parsed or foreign value, and what was wrong with it.

    Parameters
    ----------
    value : object
        Result of `load_json`, or a mapping of any origin.

    Returns
    -------
    value, faults
        The copy (containers that hold only finite numbers may be shared), and the faults found.

    Raises
    ------
    SceneError
        When there are more than `MAX_NODES` values, or the value changes under the walk.

    """
    cleaner = _Cleaner()
    return cleaner.clean(value, "", 0), cleaner.faults

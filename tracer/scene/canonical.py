"""One text for each document: the base of its hash.

Invariant: equal documents have equal bytes, and parsing the bytes gives an equal document. Keys are sorted, there are
no spaces, defaults are written out, members that are None are left out, numbers are the shortest text that reads back
as the same float64 (Python's repr), and -0.0 is written as 0.0, since it equals it.
"""

import hashlib
import json
from typing import Any

from pydantic import BaseModel

from tracer.scene.document import SceneDoc


def canonical_value(value: object) -> Any:
    """Plain JSON value of a model, or of anything inside one."""
    if isinstance(value, BaseModel):
        members = ((name, getattr(value, name)) for name in type(value).model_fields)
        return {name: canonical_value(member) for name, member in members if member is not None}
    if isinstance(value, dict):
        return {key: canonical_value(member) for key, member in value.items()}
    if isinstance(value, float):
        return value + 0.0  # -0.0 + 0.0 is 0.0
    if isinstance(value, tuple):
        return _canonical_items(value)
    return value


def _canonical_items(items: tuple[Any, ...]) -> list[Any]:
    """Items of an array; rows of floats, as those of a mesh, take the short way."""
    kinds = set(map(type, items))
    if kinds == {float}:
        return [number + 0.0 for number in items]
    if kinds == {tuple}:
        return [[x + 0.0 if x.__class__ is float else canonical_value(x) for x in row] for row in items]
    return [canonical_value(item) for item in items]


def canonical_json(doc: SceneDoc) -> bytes:
    """Canonical JSON text of a document, UTF-8.

    Parameters
    ----------
    doc : SceneDoc
        A valid document.

    Returns
    -------
    bytes
        Sorted keys, no spaces, defaults written out.

    """
    plain = canonical_value(doc)
    return json.dumps(plain, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()


def scene_hash(doc: SceneDoc) -> str:
    """SHA-256 of the canonical JSON, as 64 lower-case hex digits."""
    return hashlib.sha256(canonical_json(doc)).hexdigest()

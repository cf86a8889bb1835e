"""pydantic's errors to faults: JSON pointers without union tags, and texts in the words of the document.

Invariant: each error gives at least one fault, whose pointer leads into the document as given; save those that only
say that a default was not made because of another error, which is told itself.
"""

from collections.abc import Iterator, Sequence
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from tracer.scene.faults import FAULTS_ERROR_TYPE, Fault, closest, one_of, pointer_of, shown
from tracer.scene.schema import Schema, described, kinds, member_names, schema_at

_ANY = object()

_UNIONS: tuple[tuple[object, ...], ...] = (
    ("camera",),
    ("lights", _ANY),
    ("objects", _ANY),
    ("objects", _ANY, "transform", _ANY),
)
"""Places of tagged unions; there pydantic puts the tag after the path. A test compares this with the schema."""


def faults_of(error: ValidationError, document: object, schema: Schema | None = None) -> Iterator[Fault]:
    """Faults of a failed validation of `document` (plain values); `schema` as `root` of `schema_at`."""
    for details in error.errors(include_url=False):
        if details["type"] == "default_factory_not_called":
            continue  # about a member that is left out and whose default follows another one, which has its own error
        tokens = _path(details["loc"], document)
        yield from _faults(details, tokens, document, schema)


def _path(location: Sequence[str | int], document: object) -> list[str | int]:
    """Path into the document of pydantic's location: without union tags, and not into scalars."""
    tokens: list[str | int] = []
    value: Any = document
    skip = False
    for token in location:
        if skip:
            skip = False
            continue
        if token == "[key]" or not isinstance(value, dict | list):  # noqa: S105 - pydantic's mark of a key
            break
        tokens.append(token)
        value = _member(value, token)
        skip = any(
            len(union) == len(tokens) and all(a is _ANY or a == b for a, b in zip(union, tokens, strict=True))
            for union in _UNIONS
        )
    return tokens


def _member(container: dict[str, Any] | list[Any], token: str | int) -> Any:
    if isinstance(container, dict):
        return container.get(str(token))
    return container[token] if isinstance(token, int) and token < len(container) else None


def _value_at(document: object, tokens: Sequence[str | int]) -> Any:
    value: Any = document
    for token in tokens:
        value = _member(value, token) if isinstance(value, dict | list) else None
    return value


def _faults(details: ErrorDetails, tokens: list[str | int], document: object, schema: Schema | None) -> Iterator[Fault]:
    """Faults of one error."""
    pointer, kind, context = pointer_of(*tokens), details["type"], details.get("ctx", {})
    if kind == FAULTS_ERROR_TYPE:
        for fault in context["faults"]:
            yield fault.below(pointer)
        return
    node = schema_at(document, tokens, schema)
    value = _value_at(document, tokens)
    if kind == "missing":
        yield Fault(pointer, "is missing", described(node))
    elif kind == "extra_forbidden":
        yield _unknown_member(tokens, document, schema)
    elif kind == "union_tag_not_found":
        yield Fault(pointer + "/type", "is missing", one_of(kinds(node)))
    elif kind == "union_tag_invalid":
        tag = value.get("type") if isinstance(value, dict) else None
        hint = closest(tag, kinds(node)) if isinstance(tag, str) else ""
        yield Fault(pointer + "/type", f"is {shown(tag)}{hint}", one_of(kinds(node)))
    elif details["loc"] and details["loc"][-1] == "[key]":
        yield Fault(pointer, f"is no valid name: {details['msg']}", "1 to 256 printable characters")
    else:
        yield Fault(pointer, _message(kind, value, details, node), described(node))


def _unknown_member(tokens: list[str | int], document: object, schema: Schema | None) -> Fault:
    """Fault of a member that no model knows."""
    allowed = member_names(schema_at(document, tokens[:-1], schema))
    name = str(tokens[-1])
    return Fault(pointer_of(*tokens), f"is no known member{closest(name, allowed)}", one_of(allowed))


def _message(kind: str, value: object, details: ErrorDetails, node: Schema | None) -> str:
    """Say what was wrong, for all kinds of errors that speak of one value."""
    if kind in {"too_long", "too_short"} and isinstance(value, dict | list):
        return f"has {len(value)} items"
    if kind in {"string_too_long", "string_too_short"} and isinstance(value, str):
        return f"has {len(value)} characters"
    if kind == "literal_error" and isinstance(value, str) and node is not None:
        return f"is {shown(value)}{closest(value, [str(option) for option in node.get('enum', [])])}"
    if kind.startswith("value_error") or kind == "assertion_error":
        return details["msg"]
    return f"is {shown(value)}"

"""The JSON Schema of the scene document, and texts made from it.

Invariant: generated from the models alone, so it cannot disagree with them on names, types and ranges. What a schema
cannot say (references between places, dependent ranges) is only in the models' validators.
"""

import copy
import functools
from collections.abc import Mapping, Sequence
from typing import Any

from tracer.scene.document import SceneDoc

Schema = dict[str, Any]

SCHEMA_ID = "urn:smalti:scene:1"


@functools.cache
def _schema() -> Schema:
    """Build the schema, once; it is not to be changed."""
    schema = SceneDoc.model_json_schema(mode="validation")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "$id": SCHEMA_ID, **schema, "title": "Scene"}


def json_schema() -> Schema:
    """JSON Schema (draft 2020-12) of the scene document, with descriptions and examples.

    Returns
    -------
    dict
        A copy that the caller may change.

    """
    return copy.deepcopy(_schema())


def without_references(schema: Schema) -> Schema:
    """Write out every reference of a schema that pydantic made; not for one that refers to itself."""
    targets = schema.get("$defs", {})

    def written_out(node: Any) -> Any:
        if isinstance(node, list):
            return [written_out(item) for item in node]
        if not isinstance(node, dict):
            return node
        whole = {**targets[node["$ref"].rsplit("/", 1)[1]], **node} if "$ref" in node else node
        return {key: written_out(value) for key, value in whole.items() if key not in {"$ref", "$defs"}}

    found: Schema = written_out(schema)
    return found


def schema_at(document: object, tokens: Sequence[str | int], root: Schema | None = None) -> Schema | None:
    """Find the schema of the value at a place of a document, or None when no schema speaks of it.

    Parameters
    ----------
    document : object
        The document (plain values), needed to choose among kinds by their `type`.
    tokens : sequence of str or int
        Path from the root; the last one may be missing from the document.
    root : dict, optional
        Schema of the whole document, without references; that of scenes by default.

    """
    node: Schema | None = _resolved(_schema() if root is None else root, document)
    value = document
    for token in tokens:
        if node is None:
            return None
        value = _member(value, token)
        node = _resolved(_child(node, token), value)
    return node


def _member(value: object, token: str | int) -> object:
    """Member of a container, or None."""
    if isinstance(value, Mapping):
        return value.get(token)
    if isinstance(value, Sequence) and not isinstance(value, str) and isinstance(token, int) and token < len(value):
        return value[token]
    return None


def _child(node: Schema, token: str | int) -> Schema | None:
    """Find the schema of a member, following alternatives."""
    if "anyOf" in node:
        return next((found for option in node["anyOf"] if (found := _child(_deref(option), token))), None)
    if isinstance(token, int):
        prefix = node.get("prefixItems", [])
        return prefix[token] if token < len(prefix) else node.get("items")
    properties = node.get("properties", {})
    if token in properties:
        return properties[token]  # type: ignore[no-any-return]
    extra = node.get("additionalProperties")
    return extra if isinstance(extra, dict) else None


def _deref(node: Schema) -> Schema:
    """Replace a reference by what it refers to, keeping the description that stands beside it."""
    if "$ref" not in node:
        return node
    target: Schema = _schema()["$defs"][node["$ref"].rsplit("/", 1)[1]]
    return {**target, **{key: value for key, value in node.items() if key != "$ref"}}


def _resolved(node: Schema | None, value: object) -> Schema | None:
    """Follow references, optional values, and the kind that `type` names."""
    if node is None:
        return None
    node = _deref(node)
    options = [option for option in node.get("anyOf", ()) if option.get("type") != "null"]
    if len(options) == 1:
        rest = {key: text for key, text in node.items() if key not in {"anyOf", "default"}}
        return _resolved({**options[0], **rest}, value)
    mapping = node.get("discriminator", {}).get("mapping")
    kind = value.get("type") if isinstance(value, Mapping) else None
    if mapping and isinstance(kind, str) and kind in mapping:
        return _deref({"$ref": mapping[kind]})
    return node


def member_names(node: Schema | None) -> list[str]:
    """Names of the members that an object may have."""
    return list(node.get("properties", {})) if node else []


def kinds(node: Schema | None) -> list[str]:
    """Values of `type` among which a place may choose."""
    return list(node.get("discriminator", {}).get("mapping", {})) if node else []


def described(node: Schema | None) -> str:
    """Say in a few words what a value of this schema is.

    Examples
    --------
    >>> described({"type": "number", "exclusiveMinimum": 0, "maximum": 1})
    'a number > 0 and <= 1'

    """
    if node is None:
        return "nothing"
    what = _shape(_deref(node))
    description = node.get("description")
    return f"{what} ({description[0].lower()}{description[1:].rstrip('.')})" if description else what


def _shape(node: Schema) -> str:
    """Type and range of a schema in words."""
    if "const" in node:
        return f"{node['const']!r}".replace("'", '"')
    if "enum" in node:
        return "one of " + ", ".join(f'"{value}"' for value in node["enum"])
    if "anyOf" in node:
        return " or ".join(_shape(_deref(option)) for option in node["anyOf"] if option.get("type") != "null")
    if "discriminator" in node:
        return "an object whose type is one of " + ", ".join(f'"{kind}"' for kind in kinds(node))
    kind = node.get("type")
    if kind in {"number", "integer"}:
        return ("a number" if kind == "number" else "a whole number") + _range(node)
    if kind == "string":
        if "pattern" in node:
            return "64 lower-case hex digits" if "0-9a-f" in node["pattern"] else f"text like {node['pattern']}"
        longest = f" of at most {node['maxLength']} characters" if "maxLength" in node else ""
        return "a text" + longest if "minLength" not in node else "a text, not empty," + longest
    if kind == "array":
        return _array_shape(node)
    if kind == "object":
        most = f" of at most {node['maxProperties']} members" if "maxProperties" in node else ""
        return "an object" + most
    return {"boolean": "true or false", "null": "null"}.get(str(kind), "a value")


def _array_shape(node: Schema) -> str:
    length = ""
    if "minItems" in node and node.get("minItems") == node.get("maxItems"):
        length = f" of {node['minItems']} items"
    elif "maxItems" in node:
        length = f" of at most {node['maxItems']} items"
    items = node.get("items")
    return f"an array{length}" + (f", each {_shape(_deref(items))}" if isinstance(items, dict) else "")


def _range(node: Schema) -> str:
    """Range of a number in words."""
    signs = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    parts = [f"{sign} {node[key]:.12g}" for key, sign in signs.items() if key in node]
    step = f", a multiple of {node['multipleOf']:.12g}" if "multipleOf" in node else ""
    return (" " + " and ".join(parts) if parts else "") + step

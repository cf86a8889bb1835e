"""The JSON Schema: complete, described, and of one mind with the models in what a schema can say."""

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from scene_documents import FULL, MINIMAL, full

from tracer.scene import SceneDoc, SceneError, canonical_json, json_schema, parse_scene
from tracer.scene.schema import described, schema_at, without_references
from tracer.scene.translate import _ANY, _UNIONS

SCHEMA = json_schema()
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)
SCENES = sorted((Path(__file__).parents[3] / "scenes").rglob("*.json"))


def test_the_schema_is_valid_draft_2020_12() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert SCHEMA["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    json.dumps(SCHEMA)


def _objects(node: Any, place: str = "") -> list[tuple[str, dict[str, Any]]]:
    if isinstance(node, list):
        return [found for index, item in enumerate(node) for found in _objects(item, f"{place}/{index}")]
    if not isinstance(node, dict):
        return []
    own = [(place, node)] if "properties" in node else []
    return own + [found for key, member in node.items() for found in _objects(member, f"{place}/{key}")]


def test_every_field_has_a_description_and_examples_that_validate() -> None:
    found = _objects(SCHEMA)
    assert len(found) >= 27
    n_fields = 0
    for place, node in found:
        assert node["additionalProperties"] is False, place
        for name, field in node["properties"].items():
            n_fields += 1
            assert len(field.get("description", "")) > 5, f"{place} {name}"
            assert field.get("examples"), f"{place} {name}"
            for example in field["examples"]:
                jsonschema.Draft202012Validator({**field, "$defs": SCHEMA["$defs"]}).validate(example)
    assert n_fields > 90


def test_all_unions_are_known_to_the_translation_of_errors() -> None:
    def unions(node: Any, path: tuple[Any, ...]) -> set[tuple[Any, ...]]:
        if "$ref" in node:
            node = SCHEMA["$defs"][node["$ref"].rsplit("/", 1)[1]]
        found = {path} if "discriminator" in node else set()
        for option in [*node.get("anyOf", []), *node.get("oneOf", [])]:
            found |= unions(option, path)
        for name, member in node.get("properties", {}).items():
            found |= unions(member, (*path, name))
        for inner in (node.get("items"), node.get("additionalProperties")):
            found |= unions(inner, (*path, _ANY)) if isinstance(inner, dict) else set()
        return found

    assert unions(SCHEMA, ()) == set(_UNIONS)


@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.stem)
def test_the_shipped_scenes_validate(scene: Path) -> None:
    text = scene.read_bytes()
    doc = parse_scene(text)
    VALIDATOR.validate(json.loads(text))
    VALIDATOR.validate(json.loads(canonical_json(doc)))


@pytest.mark.parametrize("document", [FULL, MINIMAL])
def test_what_the_models_accept_the_schema_accepts(document: dict[str, Any]) -> None:
    VALIDATOR.validate(document)
    VALIDATOR.validate(json.loads(canonical_json(parse_scene(document))))


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("version",), 2),
        (("camera", "type"), "fisheye"),
        (("camera", "fov_deg"), 180),
        (("camera", "fov_deg"), "40"),
        (("camera", "extra"), 1),
        (("camera", "look_at", "eye"), [0, 0]),
        (("image", "width"), 0),
        (("image", "width"), 1.5),
        (("image", "height"), True),
        (("materials", "red", "kd"), -1),
        (("materials", "red", "kd"), [0.1, 0.2]),
        (("materials", "red", "kd"), [0.1, 0.2, -0.1]),
        (("materials", "red", "two_sided"), "yes"),
        (("lights", 0), {"type": "ambient"}),
        (("lights", 0), {}),
        (("lights", 1, "direction"), "down"),
        (("objects", 0, "positions"), [[0, 0]]),
        (("objects", 0, "faces"), [[0, 1, -1]]),
        (("objects", 0, "faces"), [[0, 1, 1.5]]),
        (("objects", 0, "transform"), [{"type": "scale", "by": 0}]),
        (("objects", 0, "groups"), {"first": [0]}),
        (("objects", 3, "radius"), 0),
        (("objects", 3, "type"), "ball"),
        (("sampling", "samples"), 0),
        (("sampling", "sampler"), "halton"),
        (("sampling", "adaptive", "min_samples"), 3),
        (("background",), [1, 2, 3, 4]),
        (("assets", "wood", "sha256"), "abc"),
        (("unknown",), 1),
    ],
)
def test_what_the_models_refuse_the_schema_refuses(path: tuple[Any, ...], value: Any) -> None:
    document = full()
    place: Any = document
    for token in path[:-1]:
        place = place[token]
    place[path[-1]] = value
    with pytest.raises(SceneError):
        parse_scene(document)
    assert not VALIDATOR.is_valid(document)


def test_the_caller_may_change_the_schema() -> None:
    json_schema()["properties"].clear()
    assert set(json_schema()["properties"]) == set(SceneDoc.model_fields)


def test_places_are_described() -> None:
    assert described(schema_at(FULL, ["objects", 3, "radius"])) == "a number >= 1e-30 and <= 1e+30 (radius, above zero)"
    assert described(schema_at(FULL, ["lights", 0, "type"])).startswith('"ambient"')
    assert described(schema_at(FULL, ["nowhere", "at all"])) == "nothing"


def test_schemas_of_others_are_described_alike() -> None:
    schema = {
        "$defs": {"Kind": {"enum": ["a", "b"], "description": "for programmers"}},
        "properties": {
            "kind": {"$ref": "#/$defs/Kind", "description": "Which one."},
            "step": {"type": "integer", "minimum": 16, "multipleOf": 16},
        },
    }
    whole = without_references(schema)
    assert "$ref" not in json.dumps(whole)
    assert described(schema_at({}, ["kind"], whole)) == 'one of "a", "b" (which one)'
    assert described(schema_at({}, ["step"], whole)) == "a whole number >= 16, a multiple of 16"
    assert schema_at({}, ["absent"], whole) is None

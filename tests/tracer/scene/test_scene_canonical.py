"""Canonical JSON: one text for each document, and back."""

import copy
import json
import random
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from scene_documents import FULL, MINIMAL, documents

from tracer.scene import canonical_json, parse_scene, scene_hash


@settings(max_examples=150, deadline=None)
@given(documents())
def test_canonical_json_reads_back_as_the_same_document(document: dict[str, Any]) -> None:
    doc = parse_scene(document)
    text = canonical_json(doc)
    again = parse_scene(text)
    assert again == doc
    assert canonical_json(again) == text
    assert scene_hash(again) == scene_hash(doc)
    assert parse_scene(json.dumps(document)) == doc


@settings(max_examples=50, deadline=None)
@given(documents(), st.randoms(use_true_random=False))
def test_canonical_json_does_not_depend_on_the_order_of_members(document: dict[str, Any], rng: random.Random) -> None:
    assert canonical_json(parse_scene(_shuffled(document, rng))) == canonical_json(parse_scene(document))


def _shuffled(value: Any, rng: random.Random) -> Any:
    if isinstance(value, dict):
        members = [(key, _shuffled(member, rng)) for key, member in value.items()]
        rng.shuffle(members)
        return dict(members)
    return [_shuffled(item, rng) for item in value] if isinstance(value, list) else value


def test_canonical_json_of_a_known_document() -> None:
    camera = {"type": "orthographic", "height": 2}
    light = {"type": "point", "position": [-0.0, 1e22, 1e-7]}
    doc = parse_scene({"version": 1, "camera": camera, "image": {"height": 3, "width": 4}, "lights": [light]})
    assert canonical_json(doc) == (
        b'{"assets":{},"background":[0.0,0.0,0.0],"camera":{"height":2.0,"type":"orthographic"},'
        b'"image":{"height":3,"width":4},'
        b'"integrator":{"max_depth":3,"min_throughput":0.0001,"shadows":true,"type":"blinn_phong"},'
        b'"lights":[{"ambient":[0.0,0.0,0.0],"diffuse":[1.0,1.0,1.0],"position":[0.0,1e+22,1e-07],'
        b'"specular":[1.0,1.0,1.0],"type":"point"}],'
        b'"materials":{},"objects":[],"sampling":{"sampler":"sobol","samples":16,"seed":0},"version":1}'
    )
    assert scene_hash(doc) == "6e8a0208cacea852d30123a4de57a007c8f1518a7af9a24797ee495abe9782a2"


def test_companions_without_a_hash_stay_in_the_canonical_text() -> None:
    document = copy.deepcopy(FULL)
    document["assets"]["car"]["companions"]["x.png"] = None
    doc = parse_scene(document)
    assert b'"x.png":null' in canonical_json(doc)
    assert parse_scene(canonical_json(doc)) == doc


def test_adaptive_sampling_stands_in_the_text_only_where_it_is_asked_for() -> None:
    fixed, adaptive = ({**MINIMAL, "sampling": {"samples": 8, **more}} for more in ({}, {"adaptive": {}}))
    assert b"adaptive" not in canonical_json(parse_scene(fixed))
    assert b'"adaptive":{"min_samples":2,"threshold":0.01}' in canonical_json(parse_scene(adaptive))

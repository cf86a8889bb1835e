"""From a request body to what is accepted, or to every fault in it.

Job: strict JSON, the envelope's model, the scene's parser; one list of faults with pointers from the body's root.
Invariant: pure and picklable: the same function runs in a thread for small bodies and in a process of its own for large
ones (`service.parsing`), and whatever comes in, the outcome is a value or a `Problem`.
Source: RFC 8259, RFC 6901; the scene's own rules are in `tracer.scene`.
"""

import functools
import hashlib
import json
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from service import problems
from service.estimate import assets_of, estimate
from service.problems import FieldFault, Problem
from service.schemas import Estimate, JobOptions
from tracer.scene import Fault, SceneDoc, SceneError, canonical_json, parse_scene
from tracer.scene.faults import is_text, merged, pointer_of, shown
from tracer.scene.schema import Schema, without_references
from tracer.scene.text import load_json, plain
from tracer.scene.translate import faults_of

Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True)
class ParsedJob:
    """A valid job request.

    Attributes
    ----------
    options
        Output, priority, name.
    scene
        The document without its objects, which may be large and are in `scene_json`.
    scene_json
        Canonical JSON of the whole document.
    request_sha256
        Hash of the request's meaning: the same for the same request in another layout or key order.
    assets
        Name in the scene's table -> hashes that it needs; used assets only.
    estimate
        What it would take; ``assets_missing`` is still empty.
    """

    options: JobOptions
    scene: SceneDoc
    scene_json: bytes
    request_sha256: str
    assets: dict[str, tuple[str, ...]]
    estimate: Estimate


def parse_value(body: bytes) -> Any:
    """Parse strict JSON: no NaN, no repeated keys, no deep nesting, no lone surrogates.

    Raises
    ------
    Problem
        400 where it is not JSON, 422 where it is and holds what is refused.
    """
    value, faults = plain(_load(body))
    if faults:
        raise invalid(problems.REQUEST_INVALID, faults)
    return value


def parse_job(body: bytes) -> ParsedJob:
    """Parse and validate a job request.

    Raises
    ------
    Problem
        400 or 422, with every fault of envelope and scene.
    """
    value = _load(body)
    if not isinstance(value, dict):
        raise invalid(problems.REQUEST_INVALID, [Fault("", f"is {shown(value)}", "an object with the member scene")])
    envelope, faults = plain({key: member for key, member in value.items() if key != "scene"})
    for key in getattr(value, "repeated", ()):
        faults.append(Fault(pointer_of(key) if is_text(key) else "", "stands twice in its object", "each key once"))

    options = None
    try:
        options = JobOptions.model_validate(envelope)
    except ValidationError as error:
        schema = _schema_of(JobOptions)
        faults += faults_of(error, envelope, {**schema, "properties": {"scene": {}, **schema["properties"]}})

    scene = None
    scene_faults: tuple[Fault, ...] = ()
    if "scene" not in value:
        faults.append(Fault("/scene", "is missing", "a scene document, version 1"))
    else:
        try:
            scene = parse_scene(value["scene"], require_hashes=True) if isinstance(value["scene"], dict) else None
        except SceneError as error:
            scene_faults = tuple(fault.below("/scene") for fault in error.faults)
        if not isinstance(value["scene"], dict):
            scene_faults = (Fault("/scene", f"is {shown(value['scene'])}", "an object, the scene document"),)

    if faults or scene_faults or options is None or scene is None:
        kind = problems.SCENE_INVALID if scene_faults and not faults else problems.REQUEST_INVALID
        raise invalid(kind, [*faults, *scene_faults])

    scene_json = canonical_json(scene)
    head = json.dumps(options.model_dump(mode="json"), sort_keys=True, separators=(",", ":")).encode()
    return ParsedJob(
        options=options,
        scene=scene.model_copy(update={"objects": ()}),
        scene_json=scene_json,
        request_sha256=hashlib.sha256(head + b"\n" + scene_json).hexdigest(),
        assets=assets_of(scene),
        estimate=estimate(scene, scene_json, options.output.tile_size),
    )


def validate_body(model: type[Model], value: object) -> Model:
    """Validate a parsed body by its model.

    Raises
    ------
    Problem
        422 with every fault.
    """
    try:
        return model.model_validate(value)
    except ValidationError as error:
        raise invalid(problems.REQUEST_INVALID, list(faults_of(error, value, _schema_of(model)))) from None


def invalid(kind: problems.ProblemType, faults: list[Fault]) -> Problem:
    """Return the 422 problem for these faults; of very many, the first ones."""
    kept = merged(faults)
    first = kept[0]
    more = f", and {len(kept) - 1} more" if len(kept) > 1 else ""
    return Problem(
        kind,
        f"{first.pointer or 'The body'} {first.message}{more}.",
        errors=[FieldFault(fault.pointer, fault.message, fault.expected) for fault in kept],
    )


def _load(body: bytes) -> object:
    try:
        return load_json(body)
    except SceneError as error:
        fault = error.faults[0]
        kind = problems.MALFORMED_JSON if fault.message.startswith("is not") else problems.REQUEST_INVALID
        raise invalid(kind, [fault]) from None


@functools.cache
def _schema_of(model: type[BaseModel]) -> Schema:
    """Return the schema by which faults of a model say what would be right."""
    return without_references(model.model_json_schema())

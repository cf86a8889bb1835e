"""From text or mapping to a valid scene document, or to the list of all that is wrong.

Invariant: whatever comes in, either a `SceneDoc` comes out or a `SceneError`; never another exception.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import ValidationError

from tracer.scene.document import SceneDoc
from tracer.scene.faults import Fault, SceneError, merged, shown
from tracer.scene.references import asset_faults, reference_faults
from tracer.scene.text import load_json, plain
from tracer.scene.translate import faults_of


def parse_scene(data: bytes | str | Mapping[str, Any], *, require_hashes: bool = False) -> SceneDoc:
    """Parse and validate a scene document.

    Parameters
    ----------
    data : bytes, str or mapping
        JSON text (bytes are UTF-8), or a document that is parsed already.
    require_hashes : bool
        Whether each asset must have its SHA-256 and a plain relative name, as the service demands.

    Returns
    -------
    SceneDoc
        The valid, immutable document.

    Raises
    ------
    SceneError
        With every fault found: JSON pointer, what was wrong, what would be right.

    """
    value = load_json(data) if isinstance(data, bytes | bytearray | memoryview | str) else data
    document, faults = plain(value)
    if not isinstance(document, dict):
        raise SceneError([Fault("", f"is {shown(document)}", "a JSON object, the scene document")])
    doc = None
    wrong: Iterable[Fault] = ()
    try:
        doc = SceneDoc.model_validate(document)
    except ValidationError as error:
        wrong = faults_of(error, document)
    references = reference_faults(document)
    assets = asset_faults(document) if require_hashes else ()
    found = merged(faults, wrong, references, assets)
    if found or doc is None:
        raise SceneError(found)
    return doc

"""How the compiler asks for a file of the `assets` table.

Invariant: a resolver answers with a real file; its companions lie beside it under the relative names of the table.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from tracer.scene.document import SceneDoc


class AssetRef(NamedTuple):
    """One row of the `assets` table, with its name."""

    name: str
    file: str
    sha256: str | None
    companions: Mapping[str, str | None] | None


AssetResolver = Callable[[AssetRef], Path]


def asset_ref(doc: SceneDoc, name: str) -> AssetRef:
    """Return the row `name` of a document's `assets` table."""
    asset = doc.assets[name]
    return AssetRef(name, asset.file, asset.sha256, asset.companions)

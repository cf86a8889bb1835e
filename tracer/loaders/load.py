"""Choose the loader by the file's name; runs in the guarded process, except for small vertex-data JSON.

Invariant: what is not in the list of formats never reaches trimesh.
"""

from tracer.loaders.files import ModelFile
from tracer.loaders.limits import MESH_SUFFIXES
from tracer.loaders.mesh import MeshData


def load_mesh(file: ModelFile) -> MeshData:
    """Read a model of any known format.

    Raises
    ------
    LoadError
    """
    if file.suffix not in MESH_SUFFIXES:
        raise file.error(f"is of an unknown kind {file.suffix!r}", f"mesh files end in {', '.join(MESH_SUFFIXES)}")
    data = file.read()
    if file.suffix == ".json":
        from tracer.loaders.vertexdata import load_vertexdata

        return load_vertexdata(file, data)
    if file.suffix == ".obj":
        from tracer.loaders.obj import load_obj

        return load_obj(file, data)
    if file.suffix in {".glb", ".gltf"}:
        from tracer.loaders.gltf import load_gltf

        return load_gltf(file, data)
    from tracer.loaders.plain import load_off, load_ply, load_stl

    return {".ply": load_ply, ".stl": load_stl, ".off": load_off}[file.suffix](file, data)

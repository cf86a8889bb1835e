"""N24: damaged documents and models are rendered with finite pixels, or refused by an error that names the place.

A case is a scene document with some of its places changed (or its text damaged), a small model of any format with its bytes
damaged, or one of the public set of pathological models as it is. Models are read by the guarded process, hundreds
at a time: one that ends it, or that it runs out of time with, is a failure. What loads is checked, compiled and rendered.
A document that asks for many samples, pixels or bounces gets few of them: that it would take long is no fault of its.

No NaN, and nothing infinite in the float64 sums: a radiance beyond float32 is infinite in a picture by definition.
"""

import contextlib
import copy
import hashlib
import json
import tempfile
import threading
from collections import Counter
from pathlib import Path

import numpy as np
from damage import damaged_bytes, damaged_document, small_models
from n21 import scaled
from row import Row

from tests.random_scenes import random_document
from tests.tracer.loaders.loader_files import DATA, png_bytes
from tracer.loaders.errors import LoadError
from tracer.loaders.guard import LoadRequest, load_guarded
from tracer.loaders.limits import DEFAULT_LIMITS, MAX_COORDINATE, MESH_SUFFIXES
from tracer.render import Canceled, compile_scene, get_backend, list_blocks
from tracer.render.sources import SceneFiles
from tracer.scene import Fault, SceneError, parse_scene
from tracer.scene.faults import tokens_of
from tracer.types import FACE_HAS_COLORS, FACE_HAS_NORMALS, FACE_HAS_UVS

LIMITS = DEFAULT_LIMITS._replace(memory_bytes=1 << 30, cpu_s=60, wall_s=300.0)  # of a batch
FOREIGN = (".ply", ".stl", ".off")  # trimesh reads them: its exceptions, with the file's name, are what can be told
NO_END_S = 60.0  # of one small picture
BATCH = 400
PIXELS, SAMPLES, DEPTH = 32 * 32, 4, 3


class Wrong(Exception):  # noqa: N818 - what the test looks for
    """Neither rendered nor refused as it should be."""


class Loaded(SceneFiles):
    """The one model of a scene, loaded before."""

    def __init__(self, mesh):
        super().__init__()
        self._meshes["model"], self._file_names["model"] = mesh, "model"

    def load(self, scene, assets):
        """Nothing is left to do."""


def check_faults(error, document):
    """Each fault tells what is wrong, what would be right, and a place that is there (or whose parent is)."""
    if not error.faults:
        raise Wrong("no fault")
    for fault in error.faults:
        if not (fault.message and fault.expected):
            raise Wrong(f"a fault without words: {fault}")
        "".join(fault).encode()
        value = document
        tokens = tokens_of(fault.pointer)
        for index, token in enumerate(tokens):
            last = index == len(tokens) - 1
            if isinstance(value, dict) and (token in value or last):
                value = value.get(token)
            elif isinstance(value, list) and token.isdigit() and (int(token) < len(value) or last):
                value = value[int(token)] if int(token) < len(value) else None
            else:
                raise Wrong(f"{fault.pointer} leads nowhere: {fault}")


def check_refusal(error, name, folder):
    """A model's error names its file, a reason and what to mend, and no place of this machine."""
    if error.file != name or not error.reason or not error.mend:
        raise Wrong(f"says too little: {error}")
    if str(folder) in str(error):
        raise Wrong(f"tells a path: {error}")
    if "cannot be read as" in error.reason and not name.lower().endswith(FOREIGN):
        raise Wrong(f"was not foreseen: {error}")
    for bad in ("ended the loader", "took longer", "was lost", "a file before it"):
        if bad in error.reason:
            raise Wrong(str(error))


def check_mesh(mesh):
    """What the compiler relies on."""
    ok = mesh.faces.size > 0 and mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.positions)
    ok = ok and bool(np.isfinite(mesh.positions).all()) and np.abs(mesh.positions).max() <= MAX_COORDINATE
    ok = ok and mesh.face_group.min() >= 0 and mesh.face_group.max() < len(mesh.groups)
    for flag, values in ((FACE_HAS_NORMALS, mesh.normals), (FACE_HAS_UVS, mesh.uvs), (FACE_HAS_COLORS, mesh.colors)):
        chosen = (mesh.face_flags & flag).astype(bool)
        ok = ok and (not chosen.any() or bool(np.isfinite(values[mesh.faces[chosen]]).all()))
    if not ok:
        raise Wrong("arrays that are not sane")


def render(scene, find, files):
    """Render, and look at the sums."""
    compiled, _ = compile_scene(scene, find, files)
    cancel = np.zeros(1, np.int64)
    timer = threading.Timer(NO_END_S, cancel.__setitem__, (0, 1))
    timer.start()
    try:
        film = get_backend().render(compiled, list_blocks(compiled), (0, scene.sampling.samples), cancel)
    except Canceled:
        raise Wrong("no end") from None
    finally:
        timer.cancel()
    if not np.isfinite(film.sums).all():
        raise Wrong(f"{int((~np.isfinite(film.sums)).any((1, 4)).sum())} pixels are not finite")


def small(document):
    """The document with few pixels, samples and bounces, if it asks for more."""
    document = copy.deepcopy(document)
    image, sampling = document["image"], document.get("sampling") or {}
    if image["width"] * image["height"] > PIXELS:
        document["image"] = {"width": 24, "height": 18}
    if sampling.get("samples", 1) > SAMPLES:
        document["sampling"] = {**sampling, "samples": SAMPLES, "adaptive": None}
    integrator = document.get("integrator") or {}
    document["integrator"] = {**integrator, "max_depth": min(integrator.get("max_depth", DEPTH), DEPTH)}
    return document


def try_document(document, find, cache, require_hashes):
    """Parse, compile and render; the way it ended."""
    try:
        scene = parse_scene(document, require_hashes=require_hashes)
        document = small(document)
        scene = parse_scene(document)
        render(scene, find, SceneFiles(cache=cache))
    except SceneError as error:
        check_faults(error, document)
        return "refused"
    except LoadError as error:
        files = [row["file"] for row in document["assets"].values()]
        check_refusal(error, error.file if error.file in files else "a file of the table", cache)
        check_faults(SceneError([Fault(error.pointer, error.reason, error.mend)]), document)
        return "refused"
    return "rendered"


def try_text(document, rng):
    """Damaged JSON text: a document or a refusal."""
    text = damaged_bytes(json.dumps(document).encode(), rng)
    try:
        parse_scene(text)
    except SceneError as error:
        try:
            document = json.loads(text)
        except ValueError:
            document = None  # of which the whole is wrong; the words tell the line or the byte
            if not any(word in error.faults[0].message for word in ("line", "byte", "character")):
                raise Wrong(f"names no place: {error}") from None
        check_faults(error, document)


def run_documents(cases, rng, folder, tally):
    """Changed documents."""
    picture = png_bytes(3, 2)
    (folder / "picture.png").write_bytes(picture)
    assets = {"picture": {"file": "picture.png", "sha256": hashlib.sha256(picture).hexdigest()}}
    for _ in range(cases):
        seed = int(rng.integers(2**31))
        case = np.random.default_rng(seed)
        document = random_document(
            seed, clear=bool(case.random() < 0.5), textured=bool(case.random() < 0.2), shapes=bool(case.random() < 0.8)
        )
        document["image"] = {"width": int(case.integers(1, 33)), "height": int(case.integers(1, 33))}
        if case.random() < 0.3:
            document = scaled(document, float(10.0 ** case.uniform(-28, 28)))
        document["assets"] = assets
        if case.random() < 0.1:
            with tally.told("text", seed):
                try_text(document, case)
            continue
        document = damaged_document(document, case)
        with tally.told("document", seed) as ended:
            ended(try_document(document, lambda ref: folder / ref.file, folder, bool(case.random() < 0.5)))


def view_of(mesh):
    """A scene that looks at a model from outside."""
    corners = mesh.positions[mesh.faces].reshape(-1, 3).astype(np.float64)
    low, high = corners.min(0), corners.max(0)
    centre, reach = low / 2 + high / 2, max(float(np.abs(high - low).max()), 1e-3 * float(np.abs(high).max()), 1e-25)
    eye = np.clip(centre + np.array([0.5, 0.4, 1.4]) * reach, -1e30, 1e30)
    return {
        "version": 1,
        "camera": {"type": "perspective", "fov_deg": 60, "look_at": {"eye": eye.tolist(), "target": centre.tolist()}},
        "image": {"width": 20, "height": 17},
        "integrator": {"max_depth": 2},
        "sampling": {"samples": 2},
        "lights": [
            {"type": "ambient", "intensity": 0.5},
            {"type": "directional", "direction": [-1, -2, -3]},
            {"type": "point", "position": eye.tolist()},
        ],
        "objects": [{"type": "mesh_asset", "asset": "model"}],
        "assets": {"model": {"file": "model"}},
    }


def try_model(result, name, folder):
    """Check a refusal, or look at what was loaded."""
    if isinstance(result, LoadError):
        check_refusal(result, name, folder)
        return "refused"
    check_mesh(result)
    document = view_of(result)
    try:
        render(parse_scene(document), None, Loaded(result))
    except SceneError as error:
        check_faults(error, document)
        return "refused"
    return "rendered"


def pathological():
    """Paths of the public set of pathological models; none where it is absent."""
    folder = DATA / "models" / "pathological"
    return sorted(path for path in folder.rglob("*") if path.suffix.lower() in MESH_SUFFIXES)


def run_models(cases, rng, folder, tally, seeds):
    """Models with damaged bytes."""
    for first in range(0, cases, BATCH):
        requests, numbers = [], []
        for _ in range(min(BATCH, cases - first)):
            number = int(rng.integers(2**31))
            case = np.random.default_rng(number)
            files = dict(seeds[case.integers(len(seeds))])
            names = list(files)
            hurt = names[0] if case.random() < 0.8 else names[case.integers(len(names))]
            files[hurt] = damaged_bytes(files[hurt], case)
            place = folder / str(len(requests))
            place.mkdir(exist_ok=True)
            for name, data in files.items():
                (place / name).write_bytes(data)
            requests.append(LoadRequest("mesh", place / names[0], names[0], names))
            numbers.append(number)
        for request, number, result in zip(requests, numbers, load_guarded(requests, LIMITS), strict=True):
            with tally.told("model", number) as ended:
                ended(try_model(result, request.name, folder))


class Tally:
    """How cases ended, and what went wrong with the first of them."""

    def __init__(self):
        self.ends = Counter()
        self.wrong = []

    @contextlib.contextmanager
    def told(self, kind, number):
        """Any exception out of a case is a failure, told with its seed."""
        ends = []
        try:
            yield ends.append
        except Exception as error:
            self.wrong.append(f"{kind} {number}: {type(error).__name__}: {error}")
        self.ends[f"{kind}s {ends[0]}" if ends else f"{kind}s"] += 1


def run(cases, seed=24):
    rng = np.random.default_rng(seed)
    tally = Tally()
    known = pathological()
    seeds = small_models()
    for path in known:
        if path.stat().st_size < 4096 and path.suffix.lower() in {".obj", ".gltf", ".glb", ".ply", ".stl", ".off"}:
            beside = [other for other in path.parent.glob(f"{path.stem}.*") if other != path]
            seeds.append({other.name: other.read_bytes() for other in (path, *beside)})
    # the larger ones at full size only
    requests = [LoadRequest("mesh", path, path.name) for path in known if cases > 1000 or path.stat().st_size < 4096]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for request, result in zip(requests, load_guarded(requests, LIMITS), strict=True):
            with tally.told("pathological model", request.name) as ended:
                ended(try_model(result, request.name, DATA))
        run_models(cases // 2, rng, folder, tally, seeds)
        run_documents(cases - cases // 2, rng, folder, tally)
    note = ", ".join(f"{count:,} {end}" for end, count in sorted(tally.ends.items()))
    if not known:
        note += "; pathological models absent (SMALTI_DATA)"
    note += "".join(f"; {text}" for text in tally.wrong[:3])
    return Row("N24", "damaged documents and models", sum(tally.ends.values()), len(tally.wrong), 0.0, 0.0, note)

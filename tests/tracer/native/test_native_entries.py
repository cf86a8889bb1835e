"""The image of the real kernels: the same bytes as numba's, without numba; and what happens where it cannot be used."""

import hashlib
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from tests.tracer.accel.meshes import icosphere
from tests.tracer.render.hand_made import mixed, settings
from tracer.accel import build_bvh, wide
from tracer.native import entries
from tracer.native.entries import ENTRIES, Entry, current_image, entry, numba_kernel
from tracer.native.key import image_path
from tracer.native.warm import warm
from tracer.render import Canceled, get_backend, list_blocks, render_compiled
from tracer.render.solids import find_solids
from tracer.types import SETTING_MIN_SAMPLES

ROOT = Path(__file__).parents[3]
# What a process of this project has of numba, as the last line of its output.
TELL = "; import sys; print(sorted({'numba', 'llvmlite', 'trimesh', 'httpx', 'rich'} & set(sys.modules)))"


@pytest.fixture(scope="module", autouse=True)
def image():
    warm()
    found = current_image()
    if found is None:
        pytest.skip("kernel images are made on Linux for x86-64 alone (tracer.native.link); elsewhere numba compiles")
    return found


@pytest.fixture
def only_numba(monkeypatch):
    """Call what numba compiles, and count the calls."""
    calls = []

    def call(self, *arguments):
        calls.append(self.name)
        return numba_kernel(self.name)(*arguments)

    def use():
        monkeypatch.setattr(Entry, "__call__", call)
        return calls

    return use


@pytest.fixture
def only_image(monkeypatch):
    """Refuse to call numba's kernels."""
    monkeypatch.setattr(entries, "numba_kernel", lambda name: pytest.fail(f"{name} went to numba"))


def run(code, *arguments, cwd=ROOT, **env):
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        cwd=cwd,
        env=os.environ | env,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def digest(arrays):
    return [hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest() for array in arrays]


def test_every_entry_is_in_the_image(image):
    assert sorted(image.doors) == sorted(ENTRIES)
    with pytest.raises(KeyError):
        entry("tracer.render.blocks.no_such_kernel")


@pytest.mark.parametrize("sampler", [0, 1, 2])
def test_pictures_have_the_bytes_of_numbas_kernels(sampler, only_numba, only_image):
    scene = mixed(settings=settings(sampler=sampler, samples=5))
    native = render_compiled(scene, threads=2)
    calls = only_numba()
    compiled = render_compiled(scene)
    assert set(calls) == {"tracer.render.blocks.render_blocks"}
    assert native.pixels.tobytes() == compiled.pixels.tobytes()
    assert native.counters == compiled.counters
    assert native.pixels.max() > 0


def test_adaptive_sampling_has_the_bytes_of_numbas_kernels(only_numba, only_image):
    scene = mixed(settings=settings(samples=5, width=64), limits=[0.0, 0.02])
    scene.settings[SETTING_MIN_SAMPLES] = 2
    native = render_compiled(scene)
    calls = only_numba()
    compiled = render_compiled(scene)
    assert set(calls) == {
        name for name in ENTRIES if name.startswith(("tracer.render.blocks.", "tracer.render.contrast."))
    }
    assert native.pixels.tobytes() == compiled.pixels.tobytes()
    assert native.counters == compiled.counters
    assert native.counters["samples_skipped_adaptive"] > 0


def test_solids_have_the_bytes_of_numbas_kernels(only_numba, only_image):
    meshes = [icosphere(level, np.random.default_rng(7), 0.01) for level in (0, 3)]
    meshes = [(vertices, faces.astype(np.int32)) for vertices, faces in meshes]
    native = find_solids(meshes)
    calls = only_numba()
    assert native.tobytes() == find_solids(meshes).tobytes()
    assert set(calls) == {name for name in ENTRIES if name.startswith("tracer.render.inside.")}
    assert len(native) == len(meshes)


@pytest.mark.parametrize("subdivisions", [0, 3, 6])
def test_trees_have_the_bytes_of_numbas_kernels(subdivisions, only_numba, only_image):
    """20, 1,280 and 81,920 triangles with a broken one, 20 others, and 40 spheres: all that builds is called."""
    rng = np.random.default_rng(7)
    vertices, faces = icosphere(subdivisions, rng, 0.01)
    vertices = np.vstack([vertices, [[np.nan, 0.0, 0.0]]])
    broken = np.vstack([faces, [[0, 1, len(vertices) - 1]]]).astype(np.int32)
    spheres = (np.zeros(40, np.int32), rng.random((40, 3)), np.tile(np.eye(3) * 0.1, (40, 1, 1)))
    few = icosphere(0)
    native = [*build_bvh(vertices, faces, *spheres), wide.build_wide(vertices, broken, threads=2).buffer]
    native.append(wide.build_wide(*few).buffer)
    calls = only_numba()
    compiled = [*build_bvh(vertices, faces, *spheres), wide.build_wide(vertices, broken).buffer]
    compiled.append(wide.build_wide(*few).buffer)
    assert digest(native) == digest(compiled)
    assert all(name.startswith("tracer.accel.") for name in calls)
    if subdivisions == 6:
        building = {name for name in ENTRIES if name.startswith("tracer.accel.")}
        assert set(calls) == building - {"tracer.accel.emit.emit_single_leaf"}


def test_other_types_go_to_numba(image):
    """Vertices of float32 are not of the image; the tree is that of the same vertices in float64."""
    vertices, faces = icosphere(2)
    narrow = vertices.astype(np.float32)
    assert digest([wide.build_wide(narrow, faces).buffer]) == digest(
        [wide.build_wide(narrow.astype(float), faces).buffer]
    )
    assert image is current_image()


def test_many_threads_call_at_once(only_image):
    scene = mixed(settings=settings(samples=4))
    expected = render_compiled(scene).pixels.tobytes()
    found = []

    def work():
        vertices, faces = icosphere(3)
        for _ in range(3):
            wide.build_wide(vertices, faces)
            found.append(render_compiled(scene, threads=2).pixels.tobytes())

    threads = [threading.Thread(target=work) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [expected] * 18


def test_the_gil_is_free_and_the_flag_is_seen(only_image):
    """While one thread renders for long, another goes on in Python, and stops it."""
    scene = mixed(settings=settings(width=1600, height=1600, samples=64))
    cancel = np.zeros(1, np.int64)
    ended = threading.Event()

    def work():
        with pytest.raises(Canceled):
            get_backend().render(scene, list_blocks(scene), (0, 64), cancel)
        ended.set()

    thread = threading.Thread(target=work)
    thread.start()
    time.sleep(0.05)
    assert not ended.is_set()
    cancel[0] = 1
    assert ended.wait(10)


def test_a_render_from_the_command_line_loads_no_compiler(tmp_path):
    scene = ROOT / "scenes" / "demo.json"
    code = """
import sys
from client.cli import app
app(["render", sys.argv[1], "-o", sys.argv[2], "--size", "32x32", "--samples", "1", "-q"], standalone_mode=False)
"""
    target = tmp_path / "out.png"
    assert run(code + TELL[2:], scene, target).splitlines()[-1] == "[]"
    assert target.stat().st_size > 100


def test_a_worker_loads_no_compiler():
    code = "from worker.backends import load_backend; import worker.worker; load_backend('cpu').warm()"
    assert "numba" not in run(code + TELL).splitlines()[-1]


def test_a_copy_at_another_place_uses_the_same_image(tmp_path):
    """Numba's cache knows a source by its path; the image by its text alone."""
    shutil.copytree(ROOT / "tracer", tmp_path / "tracer", ignore=shutil.ignore_patterns("__pycache__"))
    code = "import tracer; from tracer.native.warm import warm; warm(lambda: 1 / 0); print(tracer.__file__)"
    home, loaded = run(code + TELL, cwd=tmp_path).splitlines()
    assert Path(home).is_relative_to(tmp_path)
    assert loaded == "[]"


def test_plain_python_asks_for_no_image():
    code = "from tracer.native.entries import current_image; from tracer.native.warm import warm; warm(lambda: 1 / 0)"
    assert run(code + "; print(current_image())", NUMBA_DISABLE_JIT="1") == "None"


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    """A cache of this test's own, with all that numba has compiled and the image."""
    folder = image_path().parent
    shutil.copytree(folder, tmp_path / "kernels" / folder.name)
    monkeypatch.setenv("SMALTI_CACHE", str(tmp_path))
    return tmp_path / "kernels" / folder.name / image_path().name


def test_a_damaged_image_warns_and_is_made_anew(own_cache):
    whole = own_cache.read_bytes()
    own_cache.write_bytes(whole[:-1] + b"?")
    code = """
import warnings
from tests.tracer.render.hand_made import mixed
from tracer.native.warm import image_state
with warnings.catch_warnings(record=True) as seen:
    warnings.simplefilter("always")
    scene = mixed()
print("damaged" in image_state().fault, len([one for one in seen if "smalti warm" in str(one.message)]))
"""
    told = run(code + TELL[2:]).splitlines()
    assert told[0] == "True 1"
    assert "numba" in told[1]
    code = "from tracer.native.warm import warm; warm(lambda: print('compiling'))"
    assert run(code).splitlines() == ["compiling"]
    assert own_cache.read_bytes() == whole
    assert run(code) == ""


def test_of_two_processes_one_compiles(own_cache):
    own_cache.unlink()
    seconds = own_cache.with_suffix(".seconds")
    seconds.write_text("none")
    code = "from tracer.native.warm import warm; warm(lambda: print('compiling'))"
    both = [
        subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, text=True) for _ in range(2)
    ]
    assert sorted(one.communicate(timeout=280)[0].strip() for one in both) == ["", "compiling"]
    assert own_cache.stat().st_size > 10_000
    told = run("from tracer.native.warm import compile_seconds; print(compile_seconds())")
    assert float(told) == float(seconds.read_text()) > 1.0
    seconds.write_text("none")
    assert run("from tracer.native.warm import compile_seconds; print(compile_seconds())") == "0.0"


def test_the_compiler_leaves_nothing_in_this_process(own_cache):
    own_cache.unlink()
    code = "from tracer.native.warm import warm; warm(lambda: print('compiling'))"
    assert run(code + TELL).splitlines() == ["compiling", "[]"]


def test_an_image_that_cannot_be_written_is_told(own_cache):
    """A folder in its place: a warning with the reason, and numba's kernels all the same."""
    own_cache.unlink()
    own_cache.mkdir()
    code = """
import warnings
from tracer.native.warm import warm
from tracer.types import SETTING_MIN_SAMPLES
with warnings.catch_warnings(record=True) as seen:
    warnings.simplefilter("always")
    warm()
    from tests.tracer.render.hand_made import mixed
    mixed()
print(*[str(one.message) for one in seen], sep="\\n")
"""
    told = run(code + TELL[2:]).splitlines()
    assert "no image of the kernels: IsADirectoryError" in told[0]
    assert "Is a directory" in told[1]
    assert "numba" in told[-1]


@pytest.mark.parametrize("has_images", [True, False])
def test_where_no_image_can_be_numba_compiles_here(own_cache, tmp_path, has_images):
    """Another system, and a cache that cannot be: the kernels are compiled in this process."""
    own_cache.unlink()
    cache = tmp_path / "file" if has_images else tmp_path
    (tmp_path / "file").write_text("no folder")
    code = f"""
import tracer.native.warm as module
module._HAS_IMAGES = {has_images}
module.import_module = lambda name: type("Build", (), {{"compile_entries": staticmethod(lambda: print(name))}})
module.warm(lambda: print("compiling"))
"""
    assert run(code, SMALTI_CACHE=str(cache)).splitlines() == ["compiling", "tracer.native.build"]


def test_the_front_end_writes_what_numba_writes():
    """Less work between numba's steps, the same language."""
    code = """
import re, sys
from numba.core.compiler_machinery import PassManager
from tracer.native.build import compile_kernel
from tracer.native.entries import ENTRIES
from tracer.native.frontend import for_linking

numbas = PassManager._runPass
with for_linking():
    if sys.argv[1] == "numba":
        PassManager._runPass = numbas
    for name in ("tracer.accel.records.make_records", "tracer.accel.collapse.plan_nodes"):
        text = str(compile_kernel(name, ENTRIES[name]).library._get_module_for_linking())
        print(re.sub("globals.[0-9a-f]+|inttoptr .i64 [0-9]+", "", text))  # addresses of objects of this process
assert PassManager._runPass is numbas
"""
    ours, numbas = (run(code, who, PYTHONHASHSEED="0").splitlines() for who in ("ours", "numba"))
    assert len(ours) > 1000
    assert ours == numbas

"""The vector operations against numpy, on this CPU and on poorer ones: the same bits, never an illegal instruction."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from tracer.jit import kernel
from tracer.simd import address_of, features, float64x8, load, reduce_add, store

PROGRAM = Path(__file__).with_name("lane_operations.py")
X86 = platform.machine().lower() in {"x86_64", "amd64"}


def run_program(tmp_path, cpu):
    settings = dict(os.environ, SMALTI_CACHE=str(tmp_path), PYTHONPATH=os.pathsep.join([".", *sys.path]))
    settings.pop("NUMBA_CPU_FEATURES", None)
    settings.pop("NUMBA_CPU_NAME", None)
    if cpu:
        settings["NUMBA_CPU_NAME"] = cpu
        settings["NUMBA_CPU_FEATURES"] = ""  # else numba adds what this CPU has to what that one has
    done = subprocess.run([sys.executable, str(PROGRAM)], env=settings, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout.split()


@pytest.mark.skipif(not X86, reason="the CPU names are x86's")
def test_same_bits_on_every_cpu(tmp_path):
    digest, own_bytes = run_program(tmp_path, None)
    names = ["x86-64"] + (["x86-64-v3"] if int(own_bytes) >= 32 else [])
    for name, register in zip(names, ("16", "32"), strict=False):
        assert run_program(tmp_path, name) == [digest, register]


def test_this_cpu(tmp_path):
    assert run_program(tmp_path, None)


def test_register_bytes():
    assert features.register_bytes() in {16, 32, 64}


@kernel
def _sum_of_squares(values):
    source = address_of(values)
    total = load(float64x8, source) * 0.0
    for i in range(0, values.shape[0], 8):
        lanes = load(float64x8, source + 8 * i)
        total += lanes * lanes
    return reduce_add(total)


def test_kernels_are_kept_on_disk():
    _sum_of_squares(np.ones(64))
    again = numba.njit(nogil=True, cache=True, error_model="numpy")(_sum_of_squares.py_func)
    assert again(np.full(64, 2.0)) == 256.0
    assert sum(again.stats.cache_hits.values()) == 1


def test_vectors_of_two_lengths_do_not_mix():
    @numba.njit
    def mixed(values):
        return reduce_add(load(float64x8, address_of(values)) + load(features_x4, address_of(values)))

    from tracer.simd import float64x4 as features_x4

    with pytest.raises(numba.TypingError):
        mixed(np.ones(8))


def test_stores_do_not_need_alignment():
    memory = np.zeros(9, np.float64)

    @numba.njit
    def copy(values):
        store(address_of(values) + 8, load(float64x8, address_of(values)))

    memory[:8] = np.arange(8)
    copy(memory)
    assert memory.tolist() == [0, 0, 1, 2, 3, 4, 5, 6, 7]

"""Array files: plain aligned arrays come back, and whatever is damaged is refused."""

import numpy as np
import pytest

from tracer.arrayfile import ArrayFileError, load_arrays, save_arrays

_ARRAYS = {
    "doubles": np.arange(12.0).reshape(3, 4),
    "empty": np.zeros((0, 3), np.int32),
    "bytes": np.arange(5, dtype=np.uint8),
    "columns": np.arange(12, dtype=np.int64).reshape(3, 4).T,  # not C-contiguous
    "halves": np.float32([1, np.nan, -0.0]),
}


def _save(tmp_path):
    path = tmp_path / "a.arrays"
    size = save_arrays(path, _ARRAYS, {"who": ["me", 1.5]}, durable=True)
    assert path.stat().st_size == size
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.arrays"]
    return path


def test_round_trip(tmp_path):
    arrays, meta = load_arrays(_save(tmp_path))
    assert meta == {"who": ["me", 1.5]}
    assert list(arrays) == list(_ARRAYS)
    for name, array in arrays.items():
        assert np.array_equal(array, _ARRAYS[name], equal_nan=array.dtype.kind == "f")
        assert array.dtype == _ARRAYS[name].dtype
        assert type(array) is np.ndarray  # a subclass would be another type to compiled code
        assert array.flags.c_contiguous
        assert array.flags.writeable
        assert array.ctypes.data % 64 == 0 or array.size == 0


def test_writes_stay_in_this_process(tmp_path):
    path = _save(tmp_path)
    before = path.read_bytes()
    arrays, _ = load_arrays(path)
    arrays["doubles"][:] = -1
    assert path.read_bytes() == before
    assert load_arrays(path)[0]["doubles"][0, 1] == 1


def test_arrays_outlive_their_file(tmp_path):
    path = _save(tmp_path)
    arrays, _ = load_arrays(path)
    path.unlink()
    assert arrays["doubles"].sum() == 66


def test_every_damaged_byte_is_noticed_or_harmless(tmp_path):
    path = _save(tmp_path)
    data = path.read_bytes()
    for position in range(0, len(data), 3):
        damaged = bytearray(data)
        damaged[position] ^= 0x10
        path.write_bytes(damaged)
        try:
            arrays, meta = load_arrays(path)
        except ArrayFileError:
            continue
        # Only the padding between arrays is nobody's.
        assert meta == {"who": ["me", 1.5]}
        for name, array in arrays.items():
            assert np.array_equal(array, _ARRAYS[name], equal_nan=array.dtype.kind == "f")


def test_every_cut_is_noticed(tmp_path):
    path = _save(tmp_path)
    data = path.read_bytes()
    for length in range(0, len(data), 3):
        path.write_bytes(data[:length])
        with pytest.raises(ArrayFileError):
            load_arrays(path)
    path.write_bytes(data + b"\0")
    with pytest.raises(ArrayFileError):
        load_arrays(path)


def test_an_absent_file_is_not_a_damaged_one(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_arrays(tmp_path / "gone")


def test_a_failed_save_leaves_nothing(tmp_path):
    with pytest.raises(TypeError):
        save_arrays(tmp_path / "a", _ARRAYS, {"not": {1, 2}}, durable=False)
    with pytest.raises(FileNotFoundError):
        save_arrays(tmp_path / "gone" / "a", _ARRAYS, {}, durable=False)
    assert list(tmp_path.iterdir()) == []

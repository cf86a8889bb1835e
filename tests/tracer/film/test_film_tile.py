"""Film tile v2: what is written comes back bit for bit; whatever is damaged is refused by name."""

import json
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tracer.film.errors import TileError
from tracer.film.tile import MAGIC, Rect, TileHeader, blocks_of_rect, decode_tile, encode_tile, join_blocks


def _header(width: int = 5, height: int = 3) -> TileHeader:
    return TileHeader(
        rect=Rect(32, 48, width, height),
        sample_range=(0, 16),
        counters={"samples": 240, "primary_rays": 7},
        payload="sums",
        kernel_s=0.25,
        kernel_cpu_s=0.125,
        leased_at=1_700_000_000.5,
        finished_at=1_700_000_001.0,
        worker="host-1",
    )


def _tile(width: int = 5, height: int = 3) -> bytes:
    return encode_tile(_header(width, height), np.arange(2 * height * width * 3.0).reshape(2, height, width, 3))


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_round_trip_is_exact(width, height, seed):
    bits = np.random.default_rng(seed).integers(0, 2**64, (2, height, width, 3), dtype=np.uint64)
    sums = bits.view(np.float64)  # every bit pattern: NaN, infinities, denormals
    header, decoded = decode_tile(encode_tile(_header(width, height), sums))
    assert header == _header(width, height)
    assert np.array_equal(decoded.view(np.uint64), bits)
    assert decoded.dtype == np.float64
    assert decoded.flags.aligned


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_pixels_come_back_bit_for_bit(width, height, seed):
    bits = np.random.default_rng(seed).integers(0, 2**32, (height, width, 3), dtype=np.uint32)
    expected = _header(width, height)._replace(payload="pixels")
    data = encode_tile(expected, bits.view(np.float32))
    header, decoded = decode_tile(data)
    assert header == expected
    assert np.array_equal(decoded.view(np.uint32), bits)
    assert decoded.flags.aligned
    assert struct.unpack("<I", data[-4:]) == (zlib.crc32(data[:-4]),)


def test_layout_is_fixed():
    data = _tile(1, 1)
    magic, version, header_bytes, payload_bytes = struct.unpack_from("<8sIIQ", data)
    assert (magic, version, payload_bytes) == (MAGIC, 2, 48)
    assert (24 + header_bytes) % 64 == 0
    assert json.loads(data[24 : 24 + header_bytes])["rect"] == [32, 48, 1, 1]
    assert struct.unpack_from("<d", data, 24 + header_bytes + 8) == (1.0,)
    assert struct.unpack("<I", data[-4:]) == (zlib.crc32(data[:-4]),)


def test_every_single_damaged_byte_is_noticed():
    data = _tile()
    for position in range(len(data)):
        damaged = bytearray(data)
        damaged[position] ^= 0x40
        with pytest.raises(TileError):
            decode_tile(bytes(damaged))


def test_every_cut_is_noticed():
    data = _tile()
    for length in range(len(data)):
        with pytest.raises(TileError):
            decode_tile(data[:length])
    with pytest.raises(TileError):
        decode_tile(data + b"\0")


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=300))
def test_noise_is_refused(noise):
    with pytest.raises(TileError):
        decode_tile(noise)
    with pytest.raises(TileError):
        decode_tile(MAGIC + noise)


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(TileHeader._fields), _JSON)
def test_a_header_with_a_right_checksum_and_wrong_fields_is_refused_or_sane(name, value):
    """The checksum does not vouch for the sense of a header: a program of another version may have written it."""
    fields = _fields_of(_tile())
    fields[name] = value
    data = _forge(fields, np.zeros((2, 3, 5, 3)).tobytes())
    try:
        header, sums = decode_tile(data)
    except TileError:
        return
    assert header.payload == "sums"  # pixels would have half the bytes at most
    assert sums.shape == (2, header.rect.height, header.rect.width, len(header.channels))
    assert sums.nbytes == 2 * 3 * 5 * 3 * 8


def test_lengths_that_lie_allocate_nothing():
    fields = _fields_of(_tile())
    fields["rect"] = [0, 0, 2**30, 2**30]
    with pytest.raises(TileError, match="cannot have"):
        decode_tile(_forge(fields, b"\0" * 48))


def test_bytes_that_no_length_names_are_refused():
    body = _tile()[:-4] + b"more"
    with pytest.raises(TileError, match="should have"):
        decode_tile(body + struct.pack("<I", zlib.crc32(body)))


def test_nan_in_a_header_is_refused():
    fields = _fields_of(_tile())
    fields["kernel_s"] = float("nan")
    with pytest.raises(TileError, match="kernel_s"):
        decode_tile(_forge(fields, np.zeros((2, 3, 5, 3)).tobytes()))


def test_what_does_not_fit_is_not_written():
    with pytest.raises(TileError, match="sums are"):
        encode_tile(_header(), np.zeros((2, 3, 4, 3)))
    with pytest.raises(TileError, match="sums are"):
        encode_tile(_header(), np.zeros((2, 3, 5, 3), np.float32))
    with pytest.raises(TileError, match="pixels are"):
        encode_tile(_header()._replace(payload="pixels"), np.zeros((2, 3, 5, 3)))
    with pytest.raises(TileError, match="payload"):
        encode_tile(_header()._replace(payload="halves"), np.zeros((2, 3, 5, 3)))
    with pytest.raises(TileError, match="sample range"):
        encode_tile(_header()._replace(sample_range=(4, 4)), np.zeros((2, 3, 5, 3)))


def _fields_of(data: bytes) -> dict:
    header_bytes = struct.unpack_from("<8sIIQ", data)[2]
    return json.loads(data[24 : 24 + header_bytes])


def _forge(fields: dict, payload: bytes) -> bytes:
    text = json.dumps(fields).encode()
    body = struct.pack("<8sIIQ", MAGIC, 2, len(text), len(payload)) + text + payload
    return body + struct.pack("<I", zlib.crc32(body))


@given(st.integers(0, 70), st.integers(0, 70), st.integers(1, 70), st.integers(1, 70))
@settings(max_examples=60, deadline=None)
def test_blocks_join_to_the_rectangle(x, y, width, height):
    rect = Rect(x, y, width, height)
    blocks = blocks_of_rect(rect)
    # Each value names its half, absolute pixel and channel.
    half, row, column, channel = np.meshgrid(*map(np.arange, (2, 16, 16, 3)), indexing="ij")
    sums = np.stack([half * 1e8 + (by * 16 + row) * 1e4 + (bx * 16 + column) * 10 + channel for bx, by in blocks])
    joined = join_blocks(rect, sums)
    assert joined.shape == (2, height, width, 3)
    assert joined.flags.c_contiguous
    half, row, column, channel = np.meshgrid(*map(np.arange, joined.shape), indexing="ij")
    assert np.array_equal(joined, half * 1e8 + (y + row) * 1e4 + (x + column) * 10 + channel)


def test_blocks_of_an_aligned_tile():
    blocks = blocks_of_rect(Rect(16, 32, 32, 16))
    assert blocks.dtype == np.int32
    assert blocks.flags.c_contiguous
    assert blocks.tolist() == [[1, 2], [2, 2]]


def test_too_few_blocks_are_refused():
    with pytest.raises(ValueError, match="blocks"):
        join_blocks(Rect(0, 0, 32, 16), np.zeros((1, 2, 16, 16, 3)))

"""What the camera rays of a block see, asked square by square before any of them is traced (:mod:`.corners`).

Four squares of 8 x 8 pixels are asked about; one of which only parts may see one face is divided into four of 4 x 4,
if a packet has room for all of such a square's samples. The squares are the picture's, so what is known of a pixel
depends on neither the crop nor the tile nor the range of samples.
"""

from typing import Any, Final

from tracer.integrators.corners import Seen, look_at_corners, look_in_mirror, nothing_seen
from tracer.integrators.scratch import Scratch
from tracer.jit import inline, kernel
from tracer.rays.rows import PACKET
from tracer.simd import load, stand_alone, store
from tracer.simd.gateway import types
from tracer.types import BLOCK_PX, SETTING_SAMPLES, SETTING_SKIP, SceneView, Vec3

_int64: Final = types.int64
_SEEN: Final = 13  # numbers of a `Seen`, in its order
_DIVIDED: Final = 80  # bytes before that one
_SQUARE: Final = 2 * 8 * _SEEN  # bytes: what it sees, and what in the mirror that it sees
_COARSE: Final = 8  # pixels a side
_FINE: Final = 4
_N_COARSE: Final = (BLOCK_PX // _COARSE) ** 2
_N_FINE: Final = (BLOCK_PX // _FINE) ** 2
SURVEY_BYTES: Final = (_N_COARSE + _N_FINE) * _SQUARE
_UNASKED: Final = -2  # instead of a face


@inline
def _put(address: int, seen: Seen) -> None:
    store(address, seen.face)
    store(address + 8, seen.place)
    store(address + 16, seen.row)
    store(address + 24, seen.size)
    store(address + 32, seen.word)
    store(address + 40, seen.axis)
    store(address + 48, seen.lit)
    store(address + 56, seen.dark)
    store(address + 64, seen.black)
    store(address + 72, seen.away)
    store(address + _DIVIDED, _int64(seen.divided))
    store(address + 88, _int64(seen.even))
    store(address + 96, _int64(seen.plain))


@inline
def _get(address: int) -> Seen:
    return Seen(
        load(_int64, address),
        load(_int64, address + 8),
        load(_int64, address + 16),
        load(_int64, address + 24),
        load(_int64, address + 32),
        load(_int64, address + 40),
        load(_int64, address + 48),
        load(_int64, address + 56),
        load(_int64, address + 64),
        load(_int64, address + 72),
        load(_int64, address + _DIVIDED) != 0,
        load(_int64, address + 88) != 0,
        load(_int64, address + 96) != 0,
    )


@inline
def recall(survey: int, square: int) -> Any:
    """Return what is known of a square (`survey_square`): what it sees, and what in the mirror that it sees."""
    place = survey + _SQUARE * square
    return _get(place), _get(place + _SQUARE // 2)


@kernel
def _ask(view: SceneView, ambient: Vec3, scratch: Scratch, place: int, x: int, y: int, side: int) -> Any:
    """Ask about a square; returns whether its quarters may be worth asking about."""
    stand_alone()
    seen = look_at_corners(view, ambient, scratch, float(x), float(y), float(x + side), float(y + side))
    mirrored = look_in_mirror(view, ambient, scratch, seen)
    _put(place, seen)
    _put(place + _SQUARE // 2, mirrored)
    return seen.divided and mirrored.face < 0


@kernel
def start_survey(survey: int) -> None:
    """Forget all that is known."""
    for square in range(_N_COARSE + _N_FINE):
        store(survey + _SQUARE * square, _int64(_UNASKED))


@kernel
def survey_square(view: SceneView, ambient: Vec3, scratch: Scratch, survey: int, fine: int, x0: int, y0: int) -> int:
    """Return the number under which it is known what a square of 4 x 4 pixels sees; asks where nobody has.

    Parameters
    ----------
    view, ambient, scratch
        As :func:`tracer.integrators.corners.look_at_corners`.
    survey
        Address of `SURVEY_BYTES`, after `start_survey` of this block.
    fine
        Number of the square, along a Z curve.
    x0, y0
        First pixel of the block.
    """
    stand_alone()
    coarse = fine >> 2
    place = survey + _SQUARE * coarse
    x, y = x0 + _COARSE * (coarse & 1), y0 + _COARSE * (coarse >> 1)
    divided = load(_int64, place + _DIVIDED) != 0 and load(_int64, place + _SQUARE // 2) < 0
    if load(_int64, place) == _UNASKED:
        if view.settings[SETTING_SKIP] == 0:
            _put(place, nothing_seen(False))
            _put(place + _SQUARE // 2, nothing_seen(False))
            return coarse
        divided = _ask(view, ambient, scratch, place, x, y, _int64(_COARSE))
    if not divided or view.settings[SETTING_SAMPLES] * _FINE * _FINE < PACKET:
        return coarse
    part = _N_COARSE + fine
    place = survey + _SQUARE * part
    if load(_int64, place) == _UNASKED:
        _ask(view, ambient, scratch, place, x + _FINE * (fine & 1), y + _FINE * ((fine >> 1) & 1), _int64(_FINE))
        if load(_int64, place) < 0:  # what is known of all is known of its part
            _put(place, _get(survey + _SQUARE * coarse))
    return part

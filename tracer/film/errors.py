"""What can go wrong with a film.

FilmError
├── TileError        the bytes of a film tile are damaged, or not a film tile
└── ImageWriteError  an image file could not be written: the disk is full, the folder is gone
"""


class FilmError(Exception):
    """The film could not be read or written."""


class TileError(FilmError):
    """The bytes are not an undamaged film tile of version 1."""


class ImageWriteError(FilmError):
    """An image file could not be written; the message names the file."""

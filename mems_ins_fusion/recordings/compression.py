"""Decompression with the libraries that rosbags brings along, never to more than a recording plausibly holds.

A few kilobytes can unpack to gigabytes: every size is bounded before memory is spent on it.
"""
from __future__ import annotations

from mems_ins_fusion.recordings.errors import RecordingError, needs_rosbags

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
#: bytes that one chunk or message may unpack to; recorders close a chunk after some megabytes
LARGEST = 256 * 2**20
#: a whole file may unpack to this many times its size, and to LARGEST in any case
HIGHEST_RATIO = 100
_PIECE = 2**20  # bytes unpacked at once


def zstd():
    """The module for zstd: the standard library's from Python 3.14 on, before that its backport."""
    try:
        from compression import zstd as module
    except ImportError:
        with needs_rosbags('reading a compressed recording'):
            from backports import zstd as module
    return module


def decompress(data: bytes, compression: str, largest: int = LARGEST) -> bytes:
    """`data` as it was before `compression` (empty, zstd, lz4 or bz2); of data that are cut off, the beginning.

    RecordingError for an unknown compression or more than `largest` bytes. What the library raises passes on.
    """
    if compression in ('', 'none'):
        return data
    parts, size = [], 0
    while data:
        decompressor = _decompressor(compression)
        part = decompressor.decompress(data, largest + 1 - size)
        parts.append(part)
        size += len(part)
        if size > largest:
            raise RecordingError(f'a part of it unpacks to more than {largest / 1e6:.0f} MB')
        data = decompressor.unused_data if decompressor.eof else b''  # several frames may follow each other
    return b''.join(parts)


def _decompressor(compression: str):
    if compression == 'zstd':
        return zstd().ZstdDecompressor()
    if compression == 'lz4':
        with needs_rosbags('reading a compressed recording'):
            from lz4.frame import LZ4FrameDecompressor
        return LZ4FrameDecompressor()
    if compression == 'bz2':
        from bz2 import BZ2Decompressor
        return BZ2Decompressor()
    raise RecordingError(f"unknown compression '{compression}'")


def decompress_file(source, target, size: int) -> None:
    """Unpack the open zstd file `source` of `size` bytes into the open file `target`. RecordingError beyond the bound;
    zstd's own errors pass on, then the beginning is in `target`."""
    largest, written = most_unpacked(size), 0
    with zstd().open(source, 'rb') as stream:
        while piece := stream.read(_PIECE):
            written += len(piece)
            if written > largest:
                raise RecordingError(f'it unpacks to more than {largest / 1e6:.0f} MB')
            target.write(piece)


def most_unpacked(size: int) -> int:
    """Bytes that a file of `size` bytes may unpack to."""
    return max(LARGEST, HIGHEST_RATIO * size)

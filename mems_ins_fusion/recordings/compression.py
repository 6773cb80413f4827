"""Decompression with the libraries that rosbags brings along."""
from __future__ import annotations

from mems_ins_fusion.recordings.errors import RecordingError, needs_rosbags

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'


def zstd():
    """The module for zstd: the standard library's from Python 3.14 on, before that its backport."""
    try:
        from compression import zstd as module
    except ImportError:
        with needs_rosbags('reading a compressed recording'):
            from backports import zstd as module
    return module


def decompress(data: bytes, compression: str) -> bytes:
    """`data` as it was before `compression` (empty, zstd or lz4, as in MCAP). Whatever the library raises passes on."""
    if compression == '':
        return data
    if compression == 'zstd':
        return zstd().decompress(data)
    if compression == 'lz4':
        with needs_rosbags('reading a compressed recording'):
            from lz4.frame import decompress as lz4_decompress
        return lz4_decompress(data)
    raise RecordingError(f"unknown compression '{compression}'")

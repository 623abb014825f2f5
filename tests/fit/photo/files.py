"""Picture files made byte by byte."""

import struct
import zlib

import numpy as np


def png(codes: np.ndarray) -> bytes:
    """A PNG of 8 or 16 bits with 1 to 4 channels, byte by byte (Pillow writes no 16-bit colour)."""
    height, width, channels = codes.shape
    depth = 8 * codes.dtype.itemsize
    kind = {1: 0, 2: 4, 3: 2, 4: 6}[channels]
    rows = b"".join(b"\0" + row.astype(codes.dtype.newbyteorder(">")).tobytes() for row in codes)

    def chunk(name: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        )

    header = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )

"""PNG files, written by the specification."""

import struct
import zlib


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def filtered(image, bits, filters):
    """Return lines of (H, W, C) integers as PNG stores them; line y has the filter `filters[y % len]`."""
    height, width = image.shape[:2]
    lines = image.astype(">u2" if bits == 16 else ">u1").tobytes()
    step = image.shape[2] * bits // 8
    stride = width * step
    before, out = bytes(stride), b""
    for y in range(height):
        line, number = lines[y * stride : (y + 1) * stride], filters[y % len(filters)]
        coded = bytearray()
        for i, value in enumerate(line):
            a, b = (line[i - step] if i >= step else 0), before[i]
            c = before[i - step] if i >= step else 0
            p = a + b - c
            nearest = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
            coded.append((value - (0, a, b, (a + b) // 2, nearest)[number]) & 255)
        out += bytes([number]) + coded
        before = line
    return out


ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))


def png(image, bits, kind, filters=(0,), interlaced=False):
    """Return a PNG of (H, W, C) integers, by the specification."""
    passes = [image[y::dy, x::dx] for x, y, dx, dy in ADAM7] if interlaced else [image]
    data = zlib.compress(b"".join(filtered(part, bits, filters) for part in passes if part.size))
    header = struct.pack(">IIBBBBB", image.shape[1], image.shape[0], bits, kind, 0, 0, interlaced)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"tEXt", b"a\0b")
        + chunk(b"IDAT", data[:9])
        + chunk(b"IDAT", data[9:])
        + chunk(b"IEND", b"")
    )

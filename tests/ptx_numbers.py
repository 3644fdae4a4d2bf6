"""The numbers of PTX: floats and bits of 32 and 64, and what instructions make of them."""

import ctypes
import math
import struct

import numpy as np

M32, M64 = (1 << 32) - 1, (1 << 64) - 1
MASK = {"32": M32, "64": M64, "16": 0xFFFF, "8": 0xFF}
fma = ctypes.CDLL(None).fma
fma.restype, fma.argtypes = ctypes.c_double, [ctypes.c_double] * 3
fmaf = ctypes.CDLL(None).fmaf
fmaf.restype, fmaf.argtypes = ctypes.c_float, [ctypes.c_float] * 3
INF, MINUS_INF, NAN = math.inf, -math.inf, math.nan


def F(bits):
    """The float of 64 bits."""
    return struct.unpack("<d", struct.pack("<Q", bits))[0]


def U(number):
    """The 64 bits of a float."""
    return struct.unpack("<Q", struct.pack("<d", number))[0]


def F32(bits):
    """The float of 32 bits."""
    return struct.unpack("<f", struct.pack("<I", bits))[0]


def U32(number):
    """The 32 bits of a float."""
    return int(np.float32(number).view(np.uint32))


def S(bits, width):
    """The signed number of bits."""
    return bits - (1 << width) if bits >> (width - 1) else bits


def div(a, b):
    if b != 0.0:
        return a / b
    if a == 0.0 or a != a:
        return math.nan
    return math.copysign(math.inf, a) * math.copysign(1.0, b)


def mul(a, b):
    return a * b  # Python's floats overflow to infinity in products


def sqrt(a):
    return math.sqrt(a) if a >= 0.0 else (a if a == 0.0 else math.nan)


def log2(a):
    return math.log2(a) if a > 0.0 else (-math.inf if a == 0.0 else math.nan)


def least(a, b):
    if a != a or b != b:
        return b if a != a else a
    return a if a < b or (a == b and math.copysign(1.0, a) < 0.0) else b


def most(a, b):
    return -least(-a, -b)


def rounded(a, way):
    """A float without its fraction, rounded to nearest even, down, up or to zero."""
    if not math.isfinite(a) or abs(a) >= 2.0**52:
        return a
    whole = {"rni": round, "rmi": math.floor, "rpi": math.ceil, "rzi": math.trunc}[way](a)
    return math.copysign(float(whole), a)


def to_whole(a, way, kind):
    """A whole number of a float, the bounds beyond them, as of `cvt`."""
    width = int(kind[1:])
    if a != a:
        return 1 << (width - 1)
    low, high = (
        (-(1 << (width - 1)), (1 << (width - 1)) - 1) if kind[0] == "s" else (0, MASK[kind[1:]])
    )
    found = rounded(a, way)
    found = (high if found > 0 else low) if math.isinf(found) else int(found)
    return max(low, min(high, found)) & MASK[kind[1:]]


def gross(a):
    """An approximation as of `rcp.approx.ftz.f64`, whose lower 32 bits are zero."""
    bits = U(a)
    if not bits & 0x7FF0000000000000:
        bits &= 1 << 63
    return F(bits & ~M32)


def rcp_approx(a):
    return gross(div(1.0, gross(a)))


def rsqrt_approx(a):
    a = gross(a)
    return gross(div(1.0, sqrt(a))) if a else math.copysign(math.inf, a)

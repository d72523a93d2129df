"""A minimal NRRD writer and reader for the fixtures: attached, little-endian, gzip, axes along x, y, z."""

import gzip

import numpy as np

TYPES = {"uint8": "u1", "int16": "<i2", "uint16": "<u2", "uint32": "<u4", "float": "<f4", "double": "<f8"}


def _nrrd_type(dtype):
    for name, code in TYPES.items():
        if np.dtype(code) == dtype:
            return name
    raise TypeError(f"no NRRD type for {dtype}")


def dumps(array, spacing):
    """`array` is [z, y, x]; `spacing` is (x, y, z) in mm. The time stamp is left out, so equal content is equal bytes."""
    sizes = " ".join(str(n) for n in array.shape[::-1])
    rows = ["({0},0,0)", "(0,{0},0)", "(0,0,{0})"]
    directions = " ".join(row.format(repr(float(h))) for row, h in zip(rows, spacing))
    header = [
        "NRRD0004",
        f"type: {_nrrd_type(array.dtype)}",
        "dimension: 3",
        "space: left-posterior-superior",
        f"sizes: {sizes}",
        f"space directions: {directions}",
        "kinds: domain domain domain",
        "endian: little",
        "encoding: gzip",
        "space origin: (0,0,0)",
    ]
    body = np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<")).tobytes()
    return ("\n".join(header) + "\n\n").encode("ascii") + gzip.compress(body, 9, mtime=0)


def loads(data):
    """-> (array [z, y, x], spacing (x, y, z)) of what `dumps` wrote."""
    head, _, body = data.partition(b"\n\n")
    fields = dict(line.split(": ", 1) for line in head.decode("ascii").split("\n")[1:])
    sizes = [int(n) for n in fields["sizes"].split()]
    axes = [part.strip("()").split(",") for part in fields["space directions"].split()]
    spacing = tuple(float(axes[i][i]) for i in range(3))
    flat = np.frombuffer(gzip.decompress(body), TYPES[fields["type"]])
    return flat.reshape(sizes[::-1]), spacing

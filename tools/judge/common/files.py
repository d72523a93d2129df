"""The files that pass between the peers, intima and the scores: NRRD volumes, PLY meshes, polylines, tables.

Arrays are [z, y, x]; spacings and points are (x, y, z) in mm, with the centre of voxel (0, 0, 0) at the origin.
A mesh is (vertices [n, 3], faces [m, 3], normals [n, 3] or None)."""

import csv
import gzip
import zipfile

import numpy as np

NRRD_TYPES = {"uint8": "u1", "int16": "<i2", "uint16": "<u2", "float": "<f4", "double": "<f8"}
NRRD_ALIASES = {"unsigned char": "uint8", "short": "int16", "unsigned short": "uint16"}
PLY_TYPES = {"float": "<f4", "double": "<f8", "uchar": "u1", "short": "<i2", "ushort": "<u2", "int": "<i4",
             "uint": "<u4"}


def write_nrrd(path, array, spacing, origin=(0.0, 0.0, 0.0)):
    """LPS, uncompressed, so that reading it costs nobody anything."""
    kind = next(k for k, code in NRRD_TYPES.items() if np.dtype(code) == array.dtype)
    (x, y, z), o = (float(h) for h in spacing), ",".join(repr(float(v)) for v in origin)
    head = ["NRRD0004", f"type: {kind}", "dimension: 3", "space: left-posterior-superior",
            "sizes: {2} {1} {0}".format(*array.shape), f"space directions: ({x},0,0) (0,{y},0) (0,0,{z})",
            "kinds: domain domain domain", "endian: little", "encoding: raw", f"space origin: ({o})"]
    with open(path, "wb") as out:
        out.write(("\n".join(head) + "\n\n").encode())
        out.write(np.ascontiguousarray(array).tobytes())


def read_nrrd(path):
    """-> (array [z, y, x] or [z, y, x, c], spacing) of an attached, axis-aligned NRRD, raw or gzip."""
    with open(path, "rb") as file:
        head, _, body = file.read().partition(b"\n\n")
    fields = dict(line.split(": ", 1) for line in head.decode().splitlines()[1:] if ": " in line)
    if fields["encoding"] != "raw":
        body = gzip.decompress(body)
    kind = NRRD_ALIASES.get(fields["type"], fields["type"])
    sizes = [int(n) for n in fields["sizes"].split()]
    axes = [a for a in fields["space directions"].replace(", ", ",").split() if a != "none"]
    spacing = tuple(abs(float(a.strip("()").split(",")[i])) for i, a in enumerate(axes))
    return np.frombuffer(bytearray(body), NRRD_TYPES[kind]).reshape(sizes[::-1]), spacing  # some peers want it writable


def write_ply(path, mesh):
    """Binary, float32, normals where there are some."""
    vertices, faces, normals = mesh
    columns = [vertices] if normals is None else [vertices, normals]
    names = ["x", "y", "z"] + ([] if normals is None else ["nx", "ny", "nz"])
    rows = np.zeros(len(faces), [("n", "u1"), ("i", "<i4", 3)])
    rows["n"], rows["i"] = 3, faces
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    head += [f"property float {name}" for name in names]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    with open(path, "wb") as out:
        out.write(("\n".join(head) + "\n").encode())
        out.write(np.hstack(columns).astype("<f4").tobytes() + rows.tobytes())


def read_ply(path):
    """Binary little-endian triangles, with or without further properties of a vertex."""
    with open(path, "rb") as file:
        head, _, body = file.read().partition(b"end_header\n")
    counts, vertex, index = {}, [], None
    for words in (line.split() for line in head.decode().splitlines()):
        if words[0] == "element":
            counts[words[1]] = int(words[2])
        elif words[0] == "property" and words[1] != "list":
            (vertex if len(counts) == 1 else []).append((words[2], PLY_TYPES[words[1]]))
        elif words[0] == "property":
            index = [("n", PLY_TYPES[words[2]]), ("i", PLY_TYPES[words[3]], 3)]
    rows = np.frombuffer(body, np.dtype(vertex), counts["vertex"])
    faces = np.frombuffer(body, np.dtype(index), counts["face"], rows.nbytes)["i"].astype(np.int64)
    # Ours look into the lumen here, whichever way they were written.
    sign = -1 if b"FACING=OUT" in head else 1
    faces = faces[:, ::sign]
    triple = [np.stack([rows[k] for k in keys], 1).astype(float) if keys[0] in rows.dtype.names else None
              for keys in (("x", "y", "z"), ("nx", "ny", "nz"))]
    return triple[0], faces, None if triple[1] is None else sign * triple[1]


def read_line(path):
    """x, y, z of a CSV with one line of names."""
    return np.loadtxt(path, delimiter=",", skiprows=1, usecols=(0, 1, 2), ndmin=2)


def resample(points, step):
    """The polyline `points` at equal steps of about `step` mm."""
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0, length[-1], max(2, int(np.ceil(length[-1] / step)) + 1))
    return np.stack([np.interp(at, length, column) for column in points.T], 1)


def read_csv(path):
    """-> {heading: column}."""
    with open(path, newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return {k: np.array([float(r[k]) for r in rows]) for k in rows[0] if _number(rows[0][k])}


def _number(text):
    try:
        float(text)
    except ValueError:
        return False
    return True


def unzipped(archive, folder):
    """The folder with the files of a zip archive, unpacked once."""
    if not folder.is_dir():
        part = folder.with_suffix(".part")
        with zipfile.ZipFile(archive) as z:
            z.extractall(part)
        part.rename(folder)
    return folder


def normals_of(mesh):
    """Of the file; where it has none, those of the faces, weighted by area."""
    vertices, faces, given = mesh
    if given is not None:
        return given
    sums, across = np.zeros_like(vertices), np.cross(*(vertices[faces[:, k]] - vertices[faces[:, 0]] for k in (1, 2)))
    for k in range(3):
        for axis in range(3):
            sums[:, axis] += np.bincount(faces[:, k], across[:, axis], len(vertices))
    return sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-30)


def welded(mesh):
    """With vertices at the same place made one, and faces without area left out that this makes of some."""
    vertices, faces, _ = mesh
    one, number = np.unique(vertices.astype(np.float32), axis=0, return_inverse=True)
    faces = number.reshape(-1)[faces]
    kept = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return one.astype(float), faces[kept], None

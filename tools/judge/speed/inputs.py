"""The inputs on disk: phantoms on grids, meshes of phantoms, and real volumes where a folder of them is given.

A case is a name like `colon_256`: a phantom and a grid, or the name of a mesh or of a real volume. Its files are
NAME.mask.nrrd, NAME.ct.nrrd or NAME.ply, and NAME.json with what a program may know of it."""

import json
from dataclasses import dataclass
from pathlib import Path

GRIDS = {  # dims and spacing (x, y, z); each with its half for `--sizes quick`, in the same box
    "128": ((128, 128, 128), (1.0, 1.0, 1.0)),
    "256": ((256, 256, 256), (0.5, 0.5, 0.5)),
    "768": ((768, 768, 768), (1 / 6, 1 / 6, 1 / 6)),
    "ct_half": ((256, 256, 65), (1.4, 1.4, 3.0)),
    "ct": ((512, 512, 130), (0.7, 0.7, 1.5)),
}
# Phantom, sampling step mm in the 128 mm box, faces to keep: the ratios of 20, 6 and 20 that are usual for such meshes.
MESHES = {
    "vessel_20k": ("y", 1.24, 1000),
    "vessel_143k": ("y", 0.464, 7000),
    "trachea_96k": ("tube", 0.65, 15000),
    "colon_1m": ("colon", 0.2051, 50000),
}
# File, what it is (a mask, or a CT with its threshold), start and end voxels.
REAL = {
    "real_colon_mask": ("colon_label_1.nii.gz", None, (156, 131, 200), (260, 243, 28)),
    "real_colon_2_mask": ("colon_label_2.nii.gz", None, (252, 341, 9), (184, 224, 142)),
    "real_airway_mask": ("airway_label_lidc4.nii.gz", None, (253, 225, 405), (356, 111, 94)),
    "real_brain_mask": ("brain_vessels_label.nii.gz", None, (251, 113, 206), (365, 123, 170)),
    "real_colon_ct": ("colon_ct_prone_half.nrrd", -800, (52, 110, 118), None),
}
AIR_HU = -455  # half-way between the phantoms' air and wall


@dataclass(frozen=True)
class Case:
    """One input, by its place."""

    folder: Path
    name: str

    def path(self, suffix):
        return self.folder / f"{self.name}.{suffix}"

    def volume(self, which):
        """`ct` or `mask` -> (array [z, y, x], spacing (x, y, z) mm)."""
        from files import read_nrrd
        return read_nrrd(self.path(f"{which}.nrrd"))

    def mesh(self):
        from files import read_ply
        return read_ply(self.path("ply"))

    def about(self):
        """spacing, start_mm, end_mm, the CT's threshold hu (none for a label map), and for phantoms kind and box; for
        meshes faces to keep."""
        return json.loads(self.path("json").read_text())

    def voxel(self, which):
        """`start` or `end` as an index (x, y, z)."""
        about = self.about()
        return tuple(int(round(p / h)) for p, h in zip(about[f"{which}_mm"], about["spacing"]))

    def small_wall(self):
        """The mesh that VMTK starts from, made anew before each of its runs by meshes.small_wall."""
        return self.path("small-wall.npz")

    def phantom(self):
        """The formula behind it; None for real volumes."""
        import phantoms
        about = self.about()
        return phantoms.make(about["kind"], about["box"]) if "kind" in about else None


def make(case, data=None):
    """Writes the files of `case` unless they are there."""
    if case.path("json").exists():
        return
    case.folder.mkdir(parents=True, exist_ok=True)
    print(f"making {case.name}", flush=True)
    if case.name in MESHES:
        about = _mesh(case)
    elif case.name in REAL:
        about = _real(case, data)
    else:
        about = _volume(case)
    case.path("json").write_text(json.dumps(about))


def stairs(case):
    """The path of the staircase mesh of a mask, made by VTK, for programs that take a file."""
    path = case.path("stairs.ply")
    if not path.exists():
        from files import write_ply
        from peers.meshes import staircase
        from vtk_data import from_poly
        write_ply(path, from_poly(staircase(case)))
    return path


def _volume(case):
    import numpy as np

    import phantoms
    from files import write_nrrd
    kind, grid = case.name.split("_", 1)
    dims, spacing = GRIDS[grid]
    # The box of the fine grid, for its half too, so that both hold the same organ.
    fine, step = GRIDS[{"128": "256", "ct_half": "ct"}.get(grid, grid)]
    box = [(n - 1) * h for n, h in zip(fine, step)]
    phantom = phantoms.make(kind, box)
    values = phantoms.sample(phantom, dims, spacing)
    write_nrrd(case.path("mask.nrrd"), (values < 0).astype(np.uint8), spacing)
    write_nrrd(case.path("ct.nrrd"), phantoms.grey(values, spacing), spacing)
    return {"kind": kind, "box": box, "spacing": spacing, "hu": AIR_HU,
            "start_mm": phantom.axis[0].tolist(), "end_mm": phantom.axis[-1].tolist()}


def _mesh(case):
    import numpy as np

    import phantoms
    from files import write_ply
    from peers.meshes import PLAIN
    from vtk_data import apply, from_poly, image
    from score import weighted_normals
    kind, step, keep = MESHES[case.name]
    box = [127.5] * 3
    phantom = phantoms.make(kind, box)
    dims = tuple(int(np.ceil(b / step)) + 1 for b in box)
    values = np.clip(phantoms.sample(phantom, dims, [step] * 3), -4 * step, 4 * step)
    wall = apply("FlyingEdges3D", image(values, [step] * 3), SetValue=(0, 0.0), **PLAIN)
    # Merges the corners of faces without area, so that the mesh is closed.
    wall = apply("CleanPolyData", wall, SetTolerance=(0,), ConvertPolysToLinesOff=())
    vertices, faces, _ = from_poly(apply("TriangleFilter", wall, PassLinesOff=(), PassVertsOff=()))
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    if np.einsum("ij,ij->i", np.cross(b - a, c - a), phantom.slope(a)).sum() < 0:
        faces = faces[:, ::-1]
    normals, own = phantom.normal(vertices), weighted_normals(vertices, faces)
    crease = (normals * own).sum(1) < 0.87  # 30 degrees apart: the formula has an edge there, and no gradient
    normals[crease] = own[crease]
    write_ply(case.path("ply"), (vertices, faces, normals))
    return {"kind": kind, "box": box, "keep": keep, "faces": len(faces)}


def _real(case, data):
    import numpy as np
    import SimpleITK as sitk

    from files import write_nrrd
    name, hu, start, end = REAL[case.name]
    source = sitk.ReadImage(str(Path(data) / name))
    spacing, array = source.GetSpacing(), sitk.GetArrayFromImage(source)
    mask = hu is None  # its place in the world is dropped: only times are wanted
    write_nrrd(case.path("mask.nrrd" if mask else "ct.nrrd"), (array > 0).astype(np.uint8) if mask
               else array.astype(np.int16), spacing)
    mm = {f"{k}_mm": [i * h for i, h in zip(p, spacing)] for k, p in (("start", start), ("end", end)) if p}
    return {"spacing": spacing, "hu": hu, **mm}

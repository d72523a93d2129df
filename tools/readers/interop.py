"""Files that intima writes, opened by programs that are not ours: see README.md."""

import argparse
import subprocess
import tempfile
from pathlib import Path

import nrrd
import numpy as np
import pydicom

import segments
import series
import trees


def run(program, *args):
    subprocess.run([program, *map(str, args), "-q"], check=True)


def mask_of(file):
    """Voxels of a NRRD, and its affine to LPS mm."""
    voxels, head = nrrd.read(str(file))
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = head["space directions"].T, head["space origin"]
    return voxels > 0, affine


def check_series(program, folder, images, lumen, out):
    """Segments a series into a plain mask, a `.seg.nrrd` and a DICOM SEG, and compares them."""
    plain, slicer, dicom = (out / name for name in ("m.nrrd", "m.seg.nrrd", "m.dcm"))
    for file in (plain, slicer, dicom):
        run(program, "segment", folder, *lumen, "-o", file)
    wanted, affine = mask_of(plain)
    print("  .seg.nrrd, slicerio:", segments.seg_nrrd(slicer, wanted, affine))
    print("  DICOM SEG, highdicom:", segments.dicom_seg(dicom, images, wanted))
    print("  DICOM SEG, dciodvfy:", said(dicom))
    run(program, "segment", folder, *lumen, "--keep-patient", "-o", dicom)
    print("  --keep-patient, highdicom:", segments.dicom_seg(dicom, images, wanted))
    print("  --keep-patient, dciodvfy:", said(dicom))


def check_tree(program, mask, out):
    """The tree of a label map, as a table, SWC and branches."""
    table, swc, split = (out / name for name in ("t.csv", "t.swc", "b.vtp"))
    for file in (table, swc):
        run(program, "centerline", "--mask", mask, "--tree", "-o", file, "--branches", split)
    print("  SWC:", trees.swc(swc, table))
    print("  branches.vtp:", trees.branches(split))


def said(file):
    lines = segments.dciodvfy(file)
    if lines is None:
        return "not installed"
    errors = [line for line in lines if line.startswith("Error")]
    assert not errors, "\n".join(errors)
    return f"no error, {len(lines)} warnings {lines}"


def sorted_series(folder):
    """Data sets of a folder's slices along their normal."""
    images = [pydicom.dcmread(f, stop_before_pixels=True) for f in sorted(folder.rglob("*.dcm"))]
    way = np.array(images[0].ImageOrientationPatient, float)
    normal = np.cross(way[:3], way[3:])
    return sorted(images, key=lambda d: normal @ np.array(d.ImagePositionPatient, float))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--intima", default="target/release/intima", help="the program")
    parser.add_argument("--series", type=Path, help="a folder with one real CT series of .dcm files")
    parser.add_argument("--organ", default="airway", help="organ to find in it")
    parser.add_argument("--mask", type=Path, action="append", default=[], help="a label map of a tree")
    args = parser.parse_args()
    program = str(Path(args.intima).resolve())
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        for name, make in [("single files", series.single_files), ("frames", series.enhanced)]:
            at = folder / name.replace(" ", "-")
            at.mkdir()
            print(f"{name}, {series.DIMS}, oblique")
            images = make(at)
            lumen = ["--threshold", "0:", "--all-components", "--wall", "exact"]
            check_series(program, at, images, lumen, folder)
        print("tree of a phantom")
        mask = folder / "y.nrrd"
        run(program, "phantom", "y", "--size", 96, "--mask", "-o", mask)
        check_tree(program, mask, folder)
        for mask in args.mask:
            print(f"tree of {mask.name}")
            check_tree(program, mask, folder)
        if args.series:
            print(f"real series, {args.organ}")
            images = sorted_series(args.series)
            check_series(program, args.series, images, ["--organ", args.organ], folder)


if __name__ == "__main__":
    main()

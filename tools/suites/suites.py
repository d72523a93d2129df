"""Test files of other projects through intima, beside their own readers."""

import argparse
import collections
import os
import pathlib
import re
import resource
import subprocess
import sys
import tarfile
import urllib.parse
import urllib.request

import nibabel
import numpy as np
import SimpleITK as sitk
import trimesh

# Source packages that hold files, with their versions.
PACKAGES = [
    "pydicom==3.0.2",
    "nibabel==5.4.2",
    "nilearn==0.14.1",
    "dipy==1.12.1",
    "slicerio==1.4.0",
    "meshio==5.3.5",
    "pyvista==0.49.1",
    "deid==0.4.13",
]
MESHES = (".ply", ".stl", ".obj", ".vtp", ".glb")
NIFTI = (".nii", ".nii.gz", ".hdr", ".img", ".hdr.gz", ".img.gz")
OTHERS = (".nrrd", ".nhdr", ".mha", ".mhd")
DICOM = (".dcm", ".dicom", ".ima")
SECONDS = 60
MEMORY = 8 << 30
GRID_MM = 1e-3
AREA = 1e-4


def index():
    """Address of the package index that pip uses."""
    pip = [sys.executable, "-m", "pip", "config", "get", "global.index-url"]
    told = subprocess.run(pip, capture_output=True, text=True, check=False).stdout.strip()
    return os.environ.get("PIP_INDEX_URL") or told or "https://pypi.org/simple"


def fetch(package, work):
    """The folder of a source package, which is not built."""
    name, version = package.split("==")
    folder = work / f"{name.replace('-', '_')}-{version}"
    if not folder.exists():
        page_url = f"{index().rstrip('/')}/{name}/"
        page = urllib.request.urlopen(page_url, timeout=SECONDS).read().decode()
        links = re.findall(r'href="([^"#]+)', page)
        link = next(l for l in links if l.endswith(f"{folder.name}.tar.gz"))
        archive, _ = urllib.request.urlretrieve(urllib.parse.urljoin(page_url, link))
        with tarfile.open(archive) as tar:
            tar.extractall(work, filter="data")
    return folder


def files(folder):
    """Files that may be volumes or meshes."""
    known = MESHES + NIFTI + OTHERS + DICOM
    for path in sorted(folder.rglob("*")):
        name = path.name.lower()
        is_data = path.is_file() and path.suffix not in (".py", ".txt", ".md", ".rst", ".toml")
        without_end = path.suffix == "" and "test_files" in path.parts
        if is_data and (name.endswith(known) or without_end):
            yield path


def run(program, *arguments):
    """Exit code, standard output and standard error; code `None` where it does not end."""
    limit = lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    command = [program, "--device", "cpu", "--threads", "2", *map(str, arguments)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=SECONDS, preexec_fn=limit)
    except subprocess.TimeoutExpired:
        return None, "", "no end"
    return done.returncode, done.stdout.decode(), done.stderr.decode(errors="replace")


def nifti_of(path, number):
    """Values and the affine in LPS by nibabel, of one of several volumes; `None` where it does not
    read the file."""
    try:
        image = nibabel.load(path)
        values = np.asarray(image.dataobj, dtype=np.float64)
    except Exception:
        return None
    values = values.reshape(values.shape + (1,) * (3 - values.ndim))
    while values.ndim > 4 and values.shape[-1] == 1:
        values = values[..., 0]
    if values.ndim == 4:
        values = values[..., number]
    if values.ndim != 3:
        return None
    return values, np.diag([-1.0, -1.0, 1.0, 1.0]) @ image.affine


def image_of(path):
    """Values and the affine in LPS by SimpleITK; `None` where it does not read the file."""
    try:
        image = sitk.ReadImage(str(path))
    except Exception:
        return None
    if image.GetDimension() != 3 or image.GetNumberOfComponentsPerPixel() != 1:
        return None
    values = sitk.GetArrayFromImage(image).astype(np.float64).transpose(2, 1, 0)
    steps = np.array(image.GetDirection()).reshape(3, 3) @ np.diag(image.GetSpacing())
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = steps, image.GetOrigin()
    return values, affine


def difference(ours, theirs):
    """What differs between two volumes; empty where nothing does."""
    (a, to_a), (b, to_b) = ours, theirs
    if sorted(a.shape) != sorted(b.shape):
        return f"{a.shape} voxels, theirs {b.shape}"
    corners = np.array(list(np.ndindex(2, 2, 2))) * (np.array(b.shape) - 1)
    world = (to_b @ np.c_[corners, np.ones(8)].T)[:3].T
    back = (np.linalg.inv(to_a) @ np.c_[world, np.ones(8)].T)[:3].T
    off = np.abs((to_a @ np.c_[np.rint(back), np.ones(8)].T)[:3].T - world).max()
    if off > GRID_MM:
        return f"corners {off:.4f} mm off"
    index = np.array(list(np.ndindex(b.shape)))[:: max(1, b.size // 200_000)]
    at = np.linalg.inv(to_a) @ to_b @ np.c_[index, np.ones(len(index))].T
    at = np.rint(at[:3].T).astype(int)
    mine, his = a[tuple(at.T)], b[tuple(index.T)]
    same = np.isclose(mine, his, rtol=1e-5, atol=1e-6, equal_nan=True)
    return "" if same.all() else f"{(~same).sum()} of {len(index)} values differ"


def volume(program, path, work):
    out = work / "out.nrrd"
    code, _, said = run(program, "convert", path, "-o", out, "-q")
    number = 0
    if code != 0 and "--volume 0 to" in said:
        number = 1
        code, _, said = run(program, "convert", path, "-o", out, "-q", "--volume", number)
    if code != 0:
        return verdict(code, said)
    theirs = nifti_of(path, number) if path.name.lower().endswith(NIFTI) else image_of(path)
    if theirs is None:
        return "unheard", ""
    why = difference(image_of(out), theirs)
    return ("wrong", why) if why else ("equal", "")


def mesh(program, path, work):
    out = work / "out.ply"
    out.unlink(missing_ok=True)
    code, _, said = run(program, "fair", path, "-o", out, "-q")
    if code != 0:
        return verdict(code, said)
    try:
        his = trimesh.load(path, force="mesh", process=False)
        area = float(his.area)
    except Exception:
        return "unheard", ""
    mine = float(trimesh.load(out, force="mesh", process=False).area)
    is_equal = abs(mine - area) <= AREA * max(area, 1e-9)
    return ("equal", "") if is_equal else ("wrong", f"area {mine:.6g}, theirs {area:.6g}")


def verdict(code, said):
    """Refusals have a message of one line, but for a list of series."""
    lines = [line for line in said.splitlines() if line.startswith("intima: ")]
    is_said = len(lines) == 1 and len(lines[0]) > len("intima: ")
    if code in (2, 3) and is_said:
        return "refused", lines[0]
    return "crash", f"exit {code}: {said[-200:]}"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--intima", default="target/release/intima")
    parser.add_argument("--work", type=pathlib.Path, required=True)
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    columns = ["equal", "refused", "unheard", "wrong", "crash"]
    total, bad = collections.Counter(), []
    print(f"| suite | files | {' | '.join(columns)} |\n|---|{'---|' * 6}")
    refusals = collections.Counter()
    for package in PACKAGES:
        count = collections.Counter()
        try:
            folder = fetch(package, arguments.work)
        except (OSError, StopIteration):
            print(f"| {package} | not to be had | | | | | |")
            continue
        for path in files(folder):
            code, _, said = run(arguments.intima, "info", path, "--json")
            is_mesh = path.name.lower().endswith(MESHES)
            answer = verdict(code, said) if code != 0 else None
            if answer is None:
                answer = (mesh if is_mesh else volume)(arguments.intima, path, arguments.work)
            count[answer[0]] += 1
            if answer[0] in ("wrong", "crash"):
                bad.append((path.relative_to(arguments.work), *answer))
            if answer[0] == "refused":
                refusals[answer[1].split(": ", 2)[-1][:90]] += 1
        total += count
        print(f"| {package} | {count.total()} | {' | '.join(str(count[c]) for c in columns)} |")
    print(f"| all | {total.total()} | {' | '.join(str(total[c]) for c in columns)} |")
    for path, kind, why in bad:
        print(f"{kind}: {path}: {why}")
    for why, n in refusals.most_common():
        print(f"refused {n}: {why}")
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()

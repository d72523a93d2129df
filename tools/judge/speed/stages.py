"""What is compared: for each stage its cases, its peers, intima's command lines, and how the outputs are scored."""

from dataclasses import dataclass, field

from inputs import stairs

SIGMA_MM = 2.0
ALL = ["--no-fill", "--all-components"]  # the voxels as they are: what peers that contour or transform take
FLIGHT = ["--frames", "100", "--msaa", "1", "--size", "1280x720"]


@dataclass(frozen=True)
class Stage:
    """`ours` maps a row's name to how to make a command: a function of (case, output path without suffix) ->
    (arguments, output path or None), and, where the command wants a lumen, a function of the case that names it.
    Making the lumen from a mask or CT is then timed too and added, since peers start from the array.
    `peers` maps a row's name to (package, module:function, further arguments), and `prepares` that of a peer which
    wants another input than intima to what makes it, timed apart. `score` names a function of score.py;
    `columns` are (key, heading, whether less or more is better) of what it finds; the first is the headline.
    `span` names those of the command's stages that make what the peers make; without it all of them count.
    `left_out` says what of intima's work is in no time of this stage; reading and writing files never is."""

    title: str
    note: str
    quick: list
    full: list
    ours: dict
    peers: dict
    score: str
    columns: list
    real: list = field(default_factory=list)
    whole: bool = False  # processes are timed from start to exit
    span: tuple = ()
    prepares: dict = field(default_factory=dict)
    left_out: str = "nothing"


def _mask(case):
    return ["--mask", str(case.path("mask.nrrd"))]


def _mm(case, which):
    return ",".join(f"{x:.4f}" for x in case.about()[f"{which}_mm"])


def _thresholded(case):
    return [str(case.path("ct.nrrd")), "--threshold", f":{case.about()['hu']}", *ALL]


def _air(case):
    return [str(case.path("ct.nrrd")), "--threshold", f":{case.about()['hu']}", "--seed-mm", _mm(case, "start")]


def _to(suffix, make):
    """A command that writes one file, named by -o."""
    def command(case, out):
        path = f"{out}.{suffix}"
        return [*make(case), "-o", path], path
    return command


def _chain(command):
    """Of a CT from its start, or of a label map, whose largest piece is taken."""
    def make(case, out):
        lumen = _mask(case) if case.about()["hu"] is None else _air(case)
        return [command, *lumen, "--from", _mm(case, "start"), "--to", _mm(case, "end"), *FLIGHT,
                "--out", out], f"{out}/centerline.csv" if command == "run" else None
    return make


def _simplify(*more):
    return _to("ply", lambda c: ["simplify", str(c.path("ply")), "--faces", str(c.about()["keep"]), *more])


EXACT = ["--wall", "exact"]  # the same task as the peers': the contour of a threshold or of a mask


def _wall_of(of):
    """Every voxel inside, as peers contour them all."""
    return (lambda c: [*_mask(c), *ALL, *EXACT]) if of == "mask" else lambda c: [*_thresholded(c), *EXACT]


def _surface(of, *more):
    return _to("ply", lambda c: ["surface", *of(c), *more])


def _on_both(ours):
    """Each row a second time on Vulkan, software where nothing else is there; the first is on the default device."""
    def on_vulkan(make):
        def command(case, out):
            arguments, path = make(case, out)
            return [*arguments, "--device", "gpu"], path
        return command
    return ours | {f"{name} --device gpu": (on_vulkan(make), lumen) for name, (make, lumen) in ours.items()}


LUMEN = ("lumen_s", "of it lumen s", "")
NORMALS = [("angle_mean", "normals off, mean °", "less"), ("angle_p99", "99 % °", "less"),
           ("angle_max", "max °", "less"), ("wall_rms_mm", "vertices off the wall, rms mm", "less")]
WALL = [("wall_rms_mm", "off the wall, rms mm", "less"), ("faces", "faces", ""), ("degenerate", "without area", "less"),
        ("closed", "closed", "")]
LINE = [("mean_mm", "off the axis, mean mm", "less"), ("max_mm", "max mm", "less"),
        ("clear_mean", "clearance of the best, mean", "more"), ("clear_min", "least", "more"),
        ("turn", "turn °/mm", "less"), ("covered", "covered", "more")]


SMALL_WALL_FACES = 20_000  # on a million faces vmtkCenterlines takes minutes


def _small_wall(closed):
    """What makes VMTK's input, for Stage.prepares."""
    return "meshoptimizer", "meshes:small_wall", SMALL_WALL_FACES, closed


def _surface_stage(of, quick, full):
    what = "mask" if of == "mask" else "CT"
    note = {
        "mask": "The wall of a mask. From the array to positions and faces with numbered vertices, for all. "
                "SurfaceNets and constrained smoothing move vertices off the crossings, within a voxel.",
        "ct": "The wall at -455 HU of a CT, every component of it. From the array to positions and faces with "
              "numbered vertices, for all; ours counts the threshold and its bricks. "
              "Discrete Flying Edges takes the thresholded volume.",
    }[of]
    peers = {"VTK Flying Edges": ("vtk", "meshes:flying_edges", of),
             "VTK discrete Flying Edges": ("vtk", "meshes:discrete_flying_edges", of),
             "scikit-image Lewiner": ("scikit-image", "meshes:skimage_cubes", of)}
    if of == "mask":
        peers |= {"VTK SurfaceNets": ("vtk", "meshes:surface_nets", of),
                  "VTK discrete Flying Edges, constrained smoothing": ("vtk", "meshes:constrained_wall", of)}
    return Stage(
        f"surface of a {what}", note, quick, full,
        {"intima surface": (_surface(_wall_of(of), "--smooth", "0"), _wall_of(of))}, peers,
        "wall", [*WALL, LUMEN], real=["real_colon_mask"] if of == "mask" else [], span=("surface",),
        left_out="connectivity, counts and normals of the wall")


STAGES = {
    "distance": Stage(
        "distance to the wall", "Exact Euclidean, over the whole volume. Truth: SciPy in double precision, inside.",
        ["colon_128", "colon_ct_half"], ["colon_256", "colon_ct"],
        _on_both({"intima distance": (_to("nrrd", lambda c: ["distance", *_mask(c), *ALL]),
                                      lambda c: [*_mask(c), *ALL])}),
        {"SciPy": ("scipy", "volumes:scipy_distance"), "edt": ("edt", "volumes:edt_distance"),
         "edt, in the box around the mask": ("edt", "volumes:edt_distance_in_box"),
         "SimpleITK Maurer": ("SimpleITK", "volumes:maurer_distance")},
        "distance", [("max_mm", "max error mm", "less"), ("wrong", "share off by over 0.001 mm", "less"), LUMEN],
        real=["real_colon_mask"]),
    "hessian": Stage(
        "Hessian eigenvalues of the whole grey volume",
        f"sigma {SIGMA_MM} mm. Truth: SciPy's Gaussian derivatives, truncated at 6 sigma, inside; errors relative to "
        "the largest eigenvalue. SimpleITK gives a tube measure instead of eigenvalues. Ours computes on bricks; "
        "copying the volume into them and the result out of them is in its time.",
        ["colon_128"], ["colon_256"],
        _on_both({"intima hessian": (_to("nrrd", lambda c: [
            "hessian", str(c.path("ct.nrrd")), "--of", "grey", "--response", "eigenvalues", "--sigma", str(SIGMA_MM)]),
            None)}),
        {"SimpleITK objectness": ("SimpleITK", "volumes:itk_objectness", SIGMA_MM),
         "scikit-image, Gaussian derivatives": ("scikit-image", "volumes:skimage_eigenvalues", SIGMA_MM, True),
         "scikit-image, differences": ("scikit-image", "volumes:skimage_eigenvalues", SIGMA_MM, False)},
        "eigenvalues", [("rms", "rms error", "less"), ("max", "max error", "less")]),
    "ridge": Stage(
        "ridge of the distance over the lumen",
        f"Distance, blur of {SIGMA_MM} mm, Hessian, response. Scored by how far from the axis the strongest 2 % "
        "of the lumen's voxels lie, beside what all of them do. Ours computes in the lumen alone.",
        ["helix_128"], ["helix_256"],
        _on_both({"intima hessian": (_to("nrrd", lambda c: [
            "hessian", *_mask(c), "--of", "distance", "--response", "ridge", "--sigma", str(SIGMA_MM)]), _mask)}),
        {"SimpleITK": ("SimpleITK", "volumes:itk_ridge", SIGMA_MM),
         "edt + scikit-image, Gaussian derivatives": ("scikit-image", "volumes:skimage_ridge", SIGMA_MM, True),
         "edt + scikit-image, differences": ("scikit-image", "volumes:skimage_ridge", SIGMA_MM, False)},
        "ridge", [("strong_mm", "strongest, mm off the axis", "less"), ("all_mm", "all, mm", ""), LUMEN]),
    "surface": _surface_stage("mask", ["colon_128"], ["colon_256"]),
    "surface-ct": _surface_stage("ct", ["colon_128", "colon_ct_half"], ["colon_256", "colon_ct"]),
    "normals": Stage(
        "normals on a staircase",
        "Of the mesh of a mask, against the formula at each vertex. `intima fair` and the peers start from VTK's mesh; "
        "`intima surface` and SurfaceNets extract their own, on the clock. Where it does not say \"normals only\", "
        "smoothing moves the vertices. The method was made on masks of spheres, tori, tubes and folds, not of "
        "ellipsoid, cone (with a round tip) and hyperboloid (a saddle everywhere).",
        ["sphere_128", "ellipsoid_128", "cone_128", "hyperboloid_128"],
        ["sphere_128", "torus_128", "ellipsoid_128", "cone_128", "hyperboloid_128", "tube_ct", "cone_ct"],
        _on_both({"intima fair": (_to("ply", lambda c: ["fair", str(stairs(c))]), None)}) |
        {"intima fair --mask": (_to("ply", lambda c: ["fair", str(stairs(c)), *_mask(c)]), None),
         "intima surface": (_surface(_mask), _mask)},
        {"VTK, no smoothing": ("vtk", "meshes:plain_normals"),
         "VTK Laplacian, normals only": ("vtk", "meshes:laplacian_normals"),
         "VTK windowed sinc, normals only": ("vtk", "meshes:sinc_normals"),
         "VTK windowed sinc": ("vtk", "meshes:sinc_smoothing"),
         "VTK constrained smoothing": ("vtk", "meshes:constrained_smoothing"),
         "VTK SurfaceNets": ("vtk", "meshes:nets_normals"),
         "SciPy Gaussian gradient": ("scipy", "meshes:gradient_normals")},
        "normals", [*NORMALS, LUMEN]),
    "centerline": Stage(
        "centerline of a mask, between two points",
        f"Distance and path. The voxel paths are searched in the box around the mask and smoothed. VMTK takes a mesh "
        f"instead of a mask: Flying Edges of the CT, or of the mask where there is no CT, and meshoptimizer to "
        f"{SMALL_WALL_FACES:,} faces. Making that is timed apart (last column). Its network covers all branches and "
        "starts at a hole, cut off the clock; it stops at edges of more than two faces, so where decimation makes "
        "such (on the real label map) it gets all faces. Clearance is the distance to the wall over the best "
        "in the section across.",
        ["colon_128", "y_128"], ["colon_256", "helix_256", "helix_768", "tube_256", "y_256", "colon_ct"],
        _on_both({"intima centerline": (_to("csv", lambda c: [
            "centerline", *_mask(c), "--from", _mm(c, "start"), "--to", _mm(c, "end")]), _mask)}),
        {"edt + dijkstra3d": ("dijkstra3d", "lines:dijkstra3d_path", False),
         "edt + dijkstra3d, bidirectional": ("dijkstra3d", "lines:dijkstra3d_path", True),
         "edt + scikit-image MCP": ("scikit-image", "lines:skimage_path"),
         "VMTK centerlines": ("vmtk", "lines:vmtk_centerlines"),
         "VMTK network": ("vmtk", "lines:vmtk_network")},
        "line", [*LINE, LUMEN, ("mesh_s", "mesh for it, s", "")],
        real=["real_colon_mask", "real_colon_2_mask", "real_airway_mask", "real_brain_mask"],
        prepares={"VMTK centerlines": _small_wall(False), "VMTK network": _small_wall(True)}),
    "grow": Stage(
        "lumen of a CT, grown from a seed",
        "Ours also fills closed cavities and marks the boundary, and leaves the lumen in bricks. "
        "The voxels that noise moves across the threshold are the same for all.",
        ["colon_128"], ["colon_256", "colon_ct"],
        {"intima segment": (_to("nrrd", lambda c: ["segment", *_air(c), "--binary", *EXACT]), None)},
        {"SimpleITK connected threshold": ("SimpleITK", "volumes:itk_grow"),
         "scikit-image flood": ("scikit-image", "volumes:skimage_grow"),
         "cc3d": ("connected-components-3d", "volumes:cc3d_grow"),
         "SciPy label": ("scipy", "volumes:scipy_grow")},
        "overlap", [("dice", "Dice", "more"), ("voxels", "voxels", "")], real=["real_colon_ct"],
        left_out="copying the lumen out of its bricks"),
    "simplify": Stage(
        "simplification",
        "To a given number of faces. Distances both ways between the input and the result; normals against the "
        "input's, with those the program writes or leaves on the vertices it keeps, or angle-weighted ones where "
        "there are none.",
        ["vessel_20k"], ["vessel_143k", "trachea_96k", "colon_1m"],
        {"intima simplify": (_simplify(), None),
         "intima simplify --keep-vertices": (_simplify("--keep-vertices"), None)},
        {"meshoptimizer": ("meshoptimizer", "meshes:meshoptimizer"),
         "meshoptimizer, normals": ("meshoptimizer", "meshes:meshoptimizer", True),
         "fast-simplification": ("fast-simplification", "meshes:fast_simplification"),
         "VTK quadric, normals": ("vtk", "meshes:vtk_quadric"),
         "MeshLab quadric": ("pymeshlab", "meshes:pymeshlab_quadric")},
        "simplified", [("rms_mm", "rms mm", "less"), ("max_mm", "Hausdorff mm", "less"),
                       ("angle_mean", "normals off, mean °", "less"), ("angle_p99", "99 % °", "less"),
                       ("faces", "faces", ""), ("closed", "closed", "")],
        left_out="checking and repairing the mesh that was read"),
    "chain": Stage(
        "the whole chain: a volume on disk to a flight",
        "Processes from start to exit: lumen, wall, centerline and 100 frames of 1280x720 without multisampling. "
        "`intima run` also writes mask, distance field, surface and report; `record` only the frames. Both build their "
        "levels of detail, as on a first run; `again` has them from the one before. The scripts grow the lumen with "
        "SimpleITK or take the largest piece of a label map with cc3d, work in the box around it, smooth the wall by "
        "windowed sinc and bring it to a tenth with meshoptimizer before they draw; VMTK searches on that mesh.",
        ["colon_ct_half"], ["colon_ct"],
        {"intima run": (_chain("run"), None), "intima run again": (_chain("run"), None),
         "intima record": (_chain("record"), None)},
        {"VTK + dijkstra3d": ("vtk", "chain", "dijkstra3d"), "VTK + VMTK": ("vmtk", "chain", "vmtk")},
        "line", LINE, real=["real_colon_mask"], whole=True),
}

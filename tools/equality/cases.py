"""Every command of intima on the shared volumes."""

import dataclasses


@dataclasses.dataclass
class Case:
    """Commands that run one after another in one folder."""

    name: str
    commands: list


def case(name, *commands):
    """A case whose commands are split at spaces."""
    return Case(name, list(commands))


LABELS = {
    "colon-1": "--mask {data}/colon_label_1.nii.gz",
    "colon-2": "--mask {data}/colon_label_2.nii.gz",
    "airway-lidc1": "--mask {data}/airway_label_lidc1.nii.gz",
    "airway-atm-305": "--mask {data}/airway_label_atm_305.nii.gz",
    "brain": "--mask {data}/brain_vessels_label.nii.gz",
    "pulmonary": "--mask {data}/pulmonary_arteries_label.nii.gz",
}
COLON = LABELS["colon-1"]
AIRWAY = LABELS["airway-lidc1"]
CHEST = "{dicom:chest_ct_fnndsc} --organ airway"
PRONE = "{data}/colon_ct_prone_half.nrrd --organ colon"
AORTA = "{data}/aorta_mra.mha --threshold 1000:"
FRAMES = "--frames 12 --size 320x240"

CASES = [
    # reading and writing
    *[case(f"info-{v.split('.')[0]}", f"info {{data}}/{v} --json") for v in (
        "aorta_mra.mha", "CT_AVM.nii.gz", "CT_pitch.nii.gz", "head_ct_cranium.nrrd", "aneurism.nrrd",
        "abdomen_labels_96.nrrd", "chris_MRA.nii.gz")],
    *[case(f"info-{z}", f"info {{dicom:{z}}} --json") for z in ("chest_ct_fnndsc",)],
    case("convert", *[f"convert {{data}}/aorta_mra.mha -o a.{e}" for e in ("nrrd", "nii", "nii.gz", "mha", "mhd")]),
    case("convert-dicom", "convert {dicom:chest_ct_fnndsc} -o chest.nrrd"),
    case("phantoms", *[f"phantom {k} --size 64 -o {k}.nrrd --truth {k}.csv" for k in ("colon", "bend", "tube")]),
    case("phantom-noise", "phantom colon --size 48 --noise 20 -o colon.nrrd"),
    # masks and fields
    *[case(f"segment-{n}", f"segment {a} -o m.nrrd --json") for n, a in LABELS.items()],
    case("segment-organs", f"segment {PRONE} -o colon.nrrd --json", f"segment {CHEST} -o airway.nrrd --json"),
    case("segment-tagged", f"segment {PRONE} --tagged -o colon.nrrd"),
    case("distance", f"distance {COLON} -o d.nrrd --json", f"distance {AIRWAY} -o airway.nrrd"),
    case("hessian", *[f"hessian {AIRWAY} -o {r}.nrrd --response {r}" for r in ("ridge", "tubeness", "eigenvalues")]),
    # surfaces
    *[case(f"surface-{n}", f"surface {a} -o s.ply --json") for n, a in LABELS.items()],
    case("surface-formats", *[f"surface {AIRWAY} -o s.{e}" for e in ("ply", "stl", "obj", "vtp", "glb")]),
    case("surface-exact", f"surface {COLON} --wall exact -o s.ply --json"),
    case("surface-paper", f"surface {AIRWAY} --mode paper -o s.ply --json"),
    case("surface-organs", f"surface {PRONE} -o colon.ply", f"surface {CHEST} -o airway.ply"),
    case("simplify", f"surface {AIRWAY} -o s.ply", *[f"simplify s.ply --faces 4000 --metric {m} -o {m}.ply --json" for m in ("qem", "normal-qem", "paper")]),
    case("fair", f"surface {AIRWAY} -o s.ply", f"fair s.ply {AIRWAY} -o f.ply --json"),
    # lines
    *[case(f"path-{n}", f"centerline {a} -o p.csv --graph g.json --json") for n, a in LABELS.items()],
    *[case(f"tree-{n}", f"centerline {LABELS[n]} --tree -o p.vtp --branches b.vtp --json") for n in ("airway-lidc1", "brain", "pulmonary")],
    case("path-paper-airway", f"centerline {AIRWAY} --mode paper -o p.csv --unseen u.csv --json"),
    case("path-paper-colon", f"centerline {COLON} --mode paper -o p.csv --json"),
    # whole runs
    case("run-colon", f"run {COLON} --out r {FRAMES} --json"),
    case("run-airway-vds", f"run {AIRWAY} --out r {FRAMES} --lod vds --json"),
    case("run-airway-whole", f"run {AIRWAY} --out r {FRAMES} --lod off --json"),
    case("run-airway-paper", f"run {AIRWAY} --out r {FRAMES} --mode paper --json"),
    case("run-airway-gpu", f"run {AIRWAY} --out r {FRAMES} --device gpu --json"),
    case("run-chest", f"run {CHEST} --out r {FRAMES} --json"),
    case("run-prone", f"run {PRONE} --out r {FRAMES} --json"),
    case("run-aorta", f"run {AORTA} --tree --route all --out r {FRAMES} --json"),
    case("window", f"fly {AIRWAY} --script {{here}}/window.json --frames-out w", f"fly {PRONE} --script {{here}}/window.json --frames-out p"),
    case("record-views", *[f"record {AIRWAY} --out {v} --frames 4 --size 320x240 --view {v}" for v in ("overview", "split", "cube", "panorama")]),
]

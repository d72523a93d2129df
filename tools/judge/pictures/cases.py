"""Which volumes are drawn, how their lumen is chosen, what VTK contours, and who allows the pictures to be shown."""

from dataclasses import dataclass

ALLOWED = ("MIT", "Apache-2.0", "BSD-3-Clause", "CC BY 3.0", "CC BY 4.0", "CC0-1.0")  # of pictures in docs/


@dataclass(frozen=True)
class Case:
    """A volume and how it is drawn. `level` is the value VTK contours; none of a label map."""

    name: str
    title: str
    file: str
    kind: str  # airway, colon or vessel: how its places are called
    licence: str  # empty: none found, the pictures stay in out/
    source: str
    level: float | None = None
    ct: bool = False  # whether values are CT numbers, which say what lies behind the wall

    def lumen(self, path):
        """Arguments of intima that choose the lumen of the volume at `path`."""
        return ["--mask", path] if self.level is None else [path, "--organ", self.kind]

    def publishable(self):
        """Whether its licence lets its pictures stand in docs/."""
        return self.licence in ALLOWED


CASES = [
    Case("chest", "Airway of a CT", "chest_ct_fnndsc.zip", "airway", "CC BY 3.0",
         "LIDC-IDRI-0314 of The Cancer Imaging Archive (Armato et al., Data From LIDC-IDRI, 2015, "
         "doi:10.7937/K9/TCIA.2015.LO9QL9SX; Med. Phys. 38, 2011, doi:10.1118/1.3528204), through "
         "github.com/FNNDSC/data (Apache-2.0), de-identified by the archive", -500.0, ct=True),
    Case("trunk-airway", "Airway of a CT with slices of 2.5 mm", "trunk_ct_contrast.zip", "airway", "MIT",
         "github.com/nis1/Visualization-DMIM, series br_153, anonymized at its source", -500.0, ct=True),
    Case("trunk-aorta", "Aorta of the same CT", "trunk_ct_contrast.zip", "vessel", "MIT",
         "github.com/nis1/Visualization-DMIM, series br_153, anonymized at its source", 100.0, ct=True),
    Case("colon-ct", "Colon of a CT", "colon_ct_prone_half.nrrd", "colon", "",
         "github.com/tristancodez/Virtual-Colonoscopy-and-3d-Modelling", -450.0, ct=True),
    Case("colon-label", "Colon of a label map", "colon_label_3.nii.gz", "colon", "CC BY 4.0",
         "EdinGCA_3D_00090 of the Edinburgh Gut Cell Atlas, github.com/Comparative-Pathology/GCA-Models"),
    Case("airway-label", "Airway of a label map", "airway_label_atm_305.nii.gz", "airway", "MIT",
         "github.com/EndoluminalSurgicalVision-IMR/ATM-22-Related-Work, case 305: voxels that three of five methods "
         "marked"),
    Case("airway-label-lidc", "Airway of a label map, case LIDC 4", "airway_label_lidc4.nii.gz", "airway",
         "CC BY-NC-SA 4.0", "github.com/UNC-Robotics/Med-MPD"),
    Case("aneurism", "Head arteries of a rotational angiogram", "aneurism.nrrd", "vessel", "BSD-3-Clause",
         "github.com/Kitware/vtk-js-datasets, aneurism.vti", 128.0),
    Case("aorta-mra", "Aorta of an MR angiogram", "aorta_mra.mha", "vessel", "",
         "github.com/vmtk/vmtk-test-data", 1100.0),
    Case("pulmonary", "Pulmonary arteries of a label map", "pulmonary_arteries_label.nii.gz", "vessel", "Apache-2.0",
         "github.com/numisveinsson/SeqSeg, case PA000016 of PARSE 2022"),
]

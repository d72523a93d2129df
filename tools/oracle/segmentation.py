"""Segmentations as highdicom and slicerio write them, of one truth.

`seg/truth.nrrd` has a bit for each segment: 1, 2, 4. Segments 1 and 2 overlap, segment 3 has two
pieces with empty slices between. The grid is oblique: `ORIGIN`, `ROTATION`, `SPACING`.

- `seg/binary.dcm`: one bit a pixel, only frames with something in them.
- `seg/fractional.dcm`: 0.9 inside and 0.2 outside, run-length encoded.
- `seg/labels.dcm`: a label map of segments 1 and 3, JPEG-LS.
- `seg/layers.seg.nrrd`: two layers, segments 1 and 3 in the first.

Names are `Lumen`, `Outer wall`, `Polyps`; numbers 1, 2, 3, and in the layers 1, 1, 2.
"""

import datetime
import io
import tempfile
from pathlib import Path

import highdicom as hd
import numpy as np
import pydicom
import slicerio
from pydicom.sr.codedict import codes
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, JPEGLSLossless, RLELossless

NAMES = ["Lumen", "Outer wall", "Polyps"]
SPACING = (0.7, 0.8, 2.5)
ORIGIN = np.array([-30.0, 12.0, -100.0])
# Columns are unit and square to each other to the last digits that a decimal string holds.
ROTATION = np.array([[0.8, 0.36, -0.48], [0.0, 0.8, 0.6], [0.6, -0.48, 0.64]])


def truth():
    """Three masks, [k, j, i, segment]."""
    k, j, i = np.mgrid[:14, :18, :22]
    lumen = (i - 8) ** 2 + (j - 9) ** 2 + 4 * (k - 6) ** 2 < 40
    wall = (i - 11) ** 2 + (j - 10) ** 2 + 4 * (k - 6) ** 2 < 30
    polyps = ((i - 3) ** 2 + (j - 3) ** 2 < 5) & ((k == 2) | (k >= 11)) & (k < 13)
    return np.stack([lumen, wall, polyps], -1)


def affine():
    return ROTATION @ np.diag(SPACING)


def images(shape):
    """The slices that the segmentations refer to, in memory."""
    uid = iter(f"1.2.3.{n}" for n in range(1, 1000))
    study, series, frame = next(uid), next(uid), next(uid)
    out = []
    for k in range(shape[0]):
        d = pydicom.Dataset()
        d.file_meta = pydicom.dataset.FileMetaDataset()
        d.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        d.SOPClassUID, d.SOPInstanceUID = CTImageStorage, next(uid)
        d.PatientName = d.PatientID = d.PatientBirthDate = d.PatientSex = ""
        d.StudyInstanceUID, d.SeriesInstanceUID, d.FrameOfReferenceUID = study, series, frame
        d.StudyDate = d.StudyTime = d.StudyID = d.AccessionNumber = d.ReferringPhysicianName = ""
        d.Modality, d.SeriesNumber, d.InstanceNumber, d.Manufacturer = "CT", 1, k + 1, ""
        d.ImagePositionPatient = [f"{v:.8g}" for v in ORIGIN + affine()[:, 2] * k]
        d.ImageOrientationPatient = [f"{v:.8g}" for v in (*ROTATION[:, 0], *ROTATION[:, 1])]
        d.PixelSpacing, d.SliceThickness = [SPACING[1], SPACING[0]], SPACING[2]
        d.Rows, d.Columns = shape[1:3]
        d.BitsAllocated, d.BitsStored, d.HighBit, d.PixelRepresentation = 16, 16, 15, 0
        d.SamplesPerPixel, d.PhotometricInterpretation = 1, "MONOCHROME2"
        d.PixelData = bytes(2 * d.Rows * d.Columns)
        out.append(d)
    return out


def dicom(pixels, kind, syntax):
    describe = lambda n, name: hd.seg.SegmentDescription(
        n, name, codes.SCT.Organ, codes.SCT.Colon, hd.seg.SegmentAlgorithmTypeValues.MANUAL
    )
    described = [describe(n + 1, name) for n, name in enumerate(NAMES)]
    seg = hd.seg.Segmentation(
        images(pixels.shape), pixels, kind, described, "1.2.3.9000", 2, "1.2.3.9001", 1,
        "x", "x", "1", "1", transfer_syntax_uid=syntax, omit_empty_frames=True,
    )  # fmt: skip
    # What would differ from one time to the next.
    for element in seg.iterall():
        if element.VR in ("DA", "TM", "DT") and element.value:
            fixed = datetime.datetime(2000, 1, 1)
            element.value = {"DA": fixed.date(), "TM": fixed.time(), "DT": fixed}[element.VR]
        elif element.keyword == "DimensionOrganizationUID":
            element.value = "1.2.3.9002"
    out = io.BytesIO()
    seg.save_as(out)
    return out.getvalue()


def layers(masks):
    voxels = np.zeros((2, *masks.shape[:3]), np.uint8)
    voxels[0][masks[..., 0]], voxels[0][masks[..., 2]], voxels[1][masks[..., 1]] = 1, 2, 1
    to_lps = np.eye(4)
    to_lps[:3, :3], to_lps[:3, 3] = affine(), ORIGIN
    of = lambda n, label, layer: {
        "id": f"Segment_{n}", "name": NAMES[n], "color": [1, 0, 0], "labelValue": label, "layer": layer,
    }  # fmt: skip
    seg = {
        "voxels": voxels.transpose(0, 3, 2, 1),
        "ijkToLPS": to_lps,
        "encoding": "gzip",
        "containedRepresentationNames": ["Binary labelmap"],
        "segments": [of(0, 1, 0), of(1, 1, 1), of(2, 2, 0)],
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.seg.nrrd"
        slicerio.write_segmentation(str(path), seg)
        lines = path.read_bytes().split(b"\n")
        # A comment holds the time.
        return b"\n".join(line for line in lines if not line.startswith(b"# on "))


def fixture():
    masks = truth()
    kinds = hd.seg.SegmentationTypeValues
    apart = masks[..., 0] * np.uint8(1) + masks[..., 2] * np.uint8(3)
    files = {
        "binary.dcm": dicom(masks.astype(np.uint8), kinds.BINARY, ExplicitVRLittleEndian),
        "fractional.dcm": dicom(0.2 + 0.7 * masks.astype(np.float32), kinds.FRACTIONAL, RLELossless),
        "labels.dcm": dicom(apart, kinds.LABELMAP, JPEGLSLossless),
        "layers.seg.nrrd": layers(masks),
    }
    return files, (masks * np.array([1, 2, 4])).sum(-1).astype(np.uint8)


def pixels(data):
    """What is compared of two files: pixels, or layers."""
    if data.startswith(b"NRRD"):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.seg.nrrd"
            path.write_bytes(data)
            seg = slicerio.read_segmentation(str(path))
            return seg["voxels"], [(s["name"], s["labelValue"], s["layer"]) for s in seg["segments"]]
    seg = pydicom.dcmread(io.BytesIO(data))
    return seg.pixel_array, [s.SegmentLabel for s in seg.SegmentSequence]

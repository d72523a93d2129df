"""DICOM series for the checks: single files and enhanced frames of one volume, made of formulas."""

import numpy as np
import pydicom
from pydicom.uid import CTImageStorage, EnhancedCTImageStorage, ExplicitVRLittleEndian

SPACING = (0.7, 0.8, 2.5)
ORIGIN = np.array([-30.0, 12.0, -100.0])
ROTATION = np.array([[0.8, 0.36, -0.48], [0.0, 0.8, 0.6], [0.6, -0.48, 0.64]])
# 143 pixels a frame, so that frames do not end with a byte.
DIMS = (11, 13, 17)


def affine():
    """Voxel to LPS mm."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = ROTATION @ np.diag(SPACING), ORIGIN
    return out


def values():
    """A bright body in two pieces along k, with dark slices between, [i, j, k]."""
    i, j, k = np.mgrid[: DIMS[0], : DIMS[1], : DIMS[2]]
    near = (i - 5 - 0.1 * k) ** 2 + (j - 6) ** 2 < 14
    return np.where(near & (k > 1) & (k < 15) & ((k < 7) | (k > 9)), 300, -200).astype(np.int16)


def common(dataset, uid):
    d = dataset
    d.file_meta = pydicom.dataset.FileMetaDataset()
    d.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    d.SpecificCharacterSet = "ISO_IR 192"
    d.PatientName, d.PatientID, d.PatientSex = "Nobody^Ännchen", "N-17", "F"
    d.PatientBirthDate, d.StudyDate, d.StudyTime = "19700131", "20210304", "101112"
    d.ContentDate, d.ContentTime = "20210304", "101530.25"
    d.StudyID, d.AccessionNumber, d.ReferringPhysicianName = "S1", "A1", "Doctor^No"
    d.StudyInstanceUID, d.SeriesInstanceUID, d.FrameOfReferenceUID = uid + ".1", uid + ".2", uid + ".3"
    d.Modality, d.SeriesNumber = "CT", 7
    d.Columns, d.Rows = DIMS[:2]
    d.BitsAllocated, d.BitsStored, d.HighBit, d.PixelRepresentation = 16, 16, 15, 1
    d.SamplesPerPixel, d.PhotometricInterpretation = 1, "MONOCHROME2"
    d.RescaleSlope, d.RescaleIntercept = 1, 0
    return d


def position(k):
    return [f"{v:.8g}" for v in ORIGIN + affine()[:3, 2] * k]


def orientation():
    return [f"{v:.8g}" for v in (*ROTATION[:, 0], *ROTATION[:, 1])]


def single_files(folder):
    """Writes a file a slice; the data sets in the order of k."""
    out = []
    pixels = values().transpose(2, 1, 0)
    for k in range(DIMS[2]):
        d = common(pydicom.Dataset(), "1.2.3.50")
        d.SOPClassUID, d.SOPInstanceUID = CTImageStorage, f"1.2.3.50.9.{k + 1}"
        d.file_meta.MediaStorageSOPClassUID = d.SOPClassUID
        d.file_meta.MediaStorageSOPInstanceUID = d.SOPInstanceUID
        d.InstanceNumber = k + 1
        d.ImagePositionPatient, d.ImageOrientationPatient = position(k), orientation()
        d.PixelSpacing, d.SliceThickness = [SPACING[1], SPACING[0]], SPACING[2]
        d.PixelData = pixels[k].tobytes()
        d.save_as(folder / f"{(7 * k) % 17:03}.dcm", enforce_file_format=True)
        out.append(d)
    return out


def enhanced(folder):
    """Writes one file of frames; the data set, once a slice."""
    d = common(pydicom.Dataset(), "1.2.3.60")
    d.SOPClassUID, d.SOPInstanceUID = EnhancedCTImageStorage, "1.2.3.60.9"
    d.file_meta.MediaStorageSOPClassUID = d.SOPClassUID
    d.file_meta.MediaStorageSOPInstanceUID = d.SOPInstanceUID
    d.InstanceNumber, d.NumberOfFrames = 1, DIMS[2]
    shared, group = pydicom.Dataset(), pydicom.Dataset()
    group.PixelSpacing, group.SliceThickness = [SPACING[1], SPACING[0]], SPACING[2]
    shared.PixelMeasuresSequence = [group]
    way = pydicom.Dataset()
    way.ImageOrientationPatient = orientation()
    shared.PlaneOrientationSequence = [way]
    frames = []
    for k in range(DIMS[2]):
        frame, place = pydicom.Dataset(), pydicom.Dataset()
        place.ImagePositionPatient = position(k)
        frame.PlanePositionSequence = [place]
        frames.append(frame)
    d.SharedFunctionalGroupsSequence, d.PerFrameFunctionalGroupsSequence = [shared], frames
    d.PixelData = values().transpose(2, 1, 0).tobytes()
    d.save_as(folder / "frames.dcm", enforce_file_format=True)
    return [d] * DIMS[2]

"""One small slice in every compressed transfer syntax, encoded by imagecodecs and pydicom.

`codec/NAME.dcm`: 24 rows and 32 columns, a ramp with noise, 12 bits in use (8 where the name says so).
`codec/truth.nrrd` and `codec/truth_8.nrrd` hold the pixels before they were encoded; `lossy` ones come
near them.
"""

import io

import imagecodecs as ic
import numpy as np
import pydicom
import pydicom.uid
from pydicom.encaps import encapsulate
from pydicom.uid import CTImageStorage

SHAPE = (24, 32)


def truth():
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    noise = np.random.default_rng(3).integers(0, 40, SHAPE)
    return (100 * column + 7 * row + noise).astype(np.uint16) & 0xFFF


def streams():
    """name -> (transfer syntax, stream, bits)"""
    wide = truth()
    narrow = (wide >> 4).astype(np.uint8)
    return {
        "jpeg_8": ("1.2.840.10008.1.2.4.50", ic.jpeg8_encode(narrow, level=95, lossless=False), 8),
        "jpeg_12": ("1.2.840.10008.1.2.4.51", ic.jpeg8_encode(wide, level=98, bitspersample=12), 12),
        "jpeg_lossless": ("1.2.840.10008.1.2.4.70", ic.jpeg8_encode(wide, lossless=True, predictor=1, bitspersample=12), 12),
        "jpeg_ls": ("1.2.840.10008.1.2.4.80", ic.jpegls_encode(wide), 12),
        "jpeg_2000": ("1.2.840.10008.1.2.4.90", ic.jpeg2k_encode(wide, level=0, codecformat="j2k", reversible=True, bitspersample=12), 12),
        "htj2k": ("1.2.840.10008.1.2.4.201", ic.htj2k_encode(wide, reversible=True), 12),
    }


def dicom(syntax, stream, bits):
    d = pydicom.Dataset()
    d.file_meta = pydicom.dataset.FileMetaDataset()
    d.file_meta.TransferSyntaxUID = syntax
    d.file_meta.MediaStorageSOPClassUID = d.SOPClassUID = CTImageStorage
    d.file_meta.MediaStorageSOPInstanceUID = d.SOPInstanceUID = "1.2.3.1"
    d.StudyInstanceUID, d.SeriesInstanceUID, d.Modality = "1.2.3.2", "1.2.3.3", "CT"
    d.Rows, d.Columns = SHAPE
    d.SamplesPerPixel, d.PhotometricInterpretation, d.PixelRepresentation = 1, "MONOCHROME2", 0
    d.BitsAllocated = 8 if bits == 8 else 16
    d.BitsStored, d.HighBit = bits, bits - 1
    d.ImagePositionPatient, d.ImageOrientationPatient = [0, 0, 0], [1, 0, 0, 0, 1, 0]
    d.PixelSpacing, d.SliceThickness = [1, 1], 1
    d.PixelData = encapsulate([stream])
    d["PixelData"].VR = "OB"
    d["PixelData"].is_undefined_length = True
    out = io.BytesIO()
    d.save_as(out, enforce_file_format=True)
    return out.getvalue().replace(known.encode(), syntax.encode(), 1)


def fixture():
    files = {f"{name}.dcm": dicom(*made) for name, made in streams().items()}
    wide = truth()[None]
    return files, {"truth.nrrd": wide, "truth_8.nrrd": (wide >> 4).astype(np.uint8)}

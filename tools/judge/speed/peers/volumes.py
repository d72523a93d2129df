"""Peers that take a volume and give a volume. Each function prepares its input and returns the call to be timed."""

import os

import numpy as np

CORES = os.cpu_count() or 1


def _itk(array, spacing):
    import SimpleITK as sitk
    picture = sitk.GetImageFromArray(array)
    picture.SetSpacing([float(h) for h in spacing])
    return picture


def scipy_distance(case):
    from scipy import ndimage
    mask, spacing = case.volume("mask")
    return lambda: ndimage.distance_transform_edt(mask, sampling=spacing[::-1])


def edt_distance(case):
    import edt
    mask, spacing = case.volume("mask")
    return lambda: edt.edt(mask.view(bool), anisotropy=spacing[::-1], black_border=False, parallel=CORES)


def edt_distance_in_box(case):
    """Of the box around the mask alone, written back into the whole volume."""
    import edt

    from peers.lines import cropped
    mask, spacing = case.volume("mask")

    def call():
        box, low = cropped(mask)
        whole = np.zeros(mask.shape, np.float32)
        whole[tuple(slice(i, i + n) for i, n in zip(low, box.shape))] = edt.edt(
            box.view(bool), anisotropy=spacing[::-1], black_border=False, parallel=CORES)
        return whole
    return call


def maurer_distance(case):
    """Inside, to the nearest voxel outside: the map of the complement."""
    import SimpleITK as sitk
    outside = _itk(1 - case.volume("mask")[0], case.volume("mask")[1])
    return lambda: sitk.SignedMaurerDistanceMap(outside, insideIsPositive=False, squaredDistance=False,
                                                useImageSpacing=True)


def _hessian(grey, sigma, gaussian):
    from skimage.feature import hessian_matrix, hessian_matrix_eigvals
    return hessian_matrix_eigvals(hessian_matrix(grey, sigma=sigma, order="rc", use_gaussian_derivatives=gaussian))


def skimage_eigenvalues(case, sigma_mm, gaussian):
    """Ascending and per mm2, from Gaussian derivatives, or from a blur and central differences."""
    array, spacing = case.volume("ct")
    grey = array.astype(np.float32)
    return (lambda: _hessian(grey, sigma_mm / spacing[0], gaussian),
            lambda found: np.moveaxis(found[::-1], 0, -1) / spacing[0] ** 2)


def itk_objectness(case, sigma_mm):
    """Eigenvalues and a tube measure of them in one filter; the eigenvalues themselves cannot be had."""
    import SimpleITK as sitk
    grey = _itk(case.volume("ct")[0].astype(np.float32), case.volume("ct")[1])
    return lambda: sitk.ObjectnessMeasure(sitk.SmoothingRecursiveGaussian(grey, sigma_mm), objectDimension=1,
                                          brightObject=False, scaleObjectnessMeasure=False)


def itk_ridge(case, sigma_mm):
    """The same of the exact distance, bright tubes."""
    import SimpleITK as sitk
    distance = maurer_distance(case)

    def call():
        inside = sitk.Threshold(distance(), 0.0, 1e9, 0.0)
        return sitk.ObjectnessMeasure(sitk.SmoothingRecursiveGaussian(inside, sigma_mm), objectDimension=1,
                                      brightObject=True, scaleObjectnessMeasure=True)
    return call


def skimage_ridge(case, sigma_mm, gaussian):
    """max(0, -l2) of the blurred distance, edt before it; isotropic grids."""
    spacing = case.volume("mask")[1]
    if len(set(spacing)) > 1:
        raise RuntimeError("takes isotropic voxels only")
    distance = edt_distance(case)
    return lambda: np.maximum(0, -_hessian(distance(), sigma_mm / spacing[0], gaussian)[1])


def itk_grow(case):
    import SimpleITK as sitk
    grey, seed, hu = _itk(*case.volume("ct")), case.voxel("start"), case.about()["hu"]
    return lambda: sitk.ConnectedThreshold(grey, seedList=[seed], lower=-3000, upper=hu, replaceValue=1)


def skimage_grow(case):
    from skimage.segmentation import flood
    grey, seed, hu = case.volume("ct")[0], case.voxel("start")[::-1], case.about()["hu"]
    return lambda: flood((grey <= hu).view(np.uint8), seed, connectivity=1)


def scipy_grow(case):
    """Labels every component and keeps the seed's: what SciPy offers."""
    from scipy import ndimage
    grey, seed, hu = case.volume("ct")[0], case.voxel("start")[::-1], case.about()["hu"]

    def call():
        labels, _ = ndimage.label(grey <= hu)
        return labels == labels[seed]
    return call


def cc3d_grow(case):
    """Labels every component, as SciPy does, and keeps the seed's."""
    import cc3d
    grey, seed, hu = case.volume("ct")[0], case.voxel("start")[::-1], case.about()["hu"]

    def call():
        labels = cc3d.connected_components(grey <= hu, connectivity=6)
        return labels == labels[seed]
    return call

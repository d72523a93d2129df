"""VTK's walls, drawn by VTK from where intima's eye was."""

import numpy as np
import SimpleITK as sitk
import vtk
from vtk.util.numpy_support import vtk_to_numpy

from scans import masked
from vtk_data import image as vtk_image, to_poly
from vtk_walls import OF_MASKS

REACH_MM = 80.0  # what lies farther than this from the flight is left out
COLOUR = (0.93, 0.62, 0.55)
NEAR_MM, FAR_MM = 0.02, 1000.0  # nearer than intima's own near plane: VTK's wall may lie nearer to the eye


def near(image, eye_mm):
    """The part of the image within REACH_MM of the flight, in whole slices along its axes."""
    at = np.array([image.TransformPhysicalPointToContinuousIndex([float(c) for c in p]) for p in eye_mm])
    reach = REACH_MM / np.array(image.GetSpacing())
    size = np.array(image.GetSize())
    first = np.clip(np.floor(at.min(0) - reach), 0, size - 2).astype(int)
    last = np.clip(np.ceil(at.max(0) + reach), first + 1, size - 1).astype(int)
    return image[tuple(slice(int(a), int(b) + 1) for a, b in zip(first, last))]


def walls(case, image):
    """-> {name: vtkPolyData with normals}: Flying Edges of grey values; two smoothed walls of a label map."""
    if case.level is not None:
        grey = sitk.GetArrayFromImage(image).astype(np.float32)
        volume = vtk_image(grey, image.GetSpacing(), image.GetOrigin(), image.GetDirection())
        contour = vtk.vtkFlyingEdges3D()  # with its own normals, of the grey values
        contour.SetInputData(volume)
        contour.SetValue(0, case.level)
        contour.Update()
        return {f"VTK Flying Edges at {case.level:g}": contour.GetOutput()}
    array, spacing, back = masked(image)
    made = {}
    for name in ("VTK SurfaceNets", "VTK mask + windowed sinc"):
        vertices, faces, _ = OF_MASKS[name](array, spacing, (0.0, 0.0, 0.0))
        normals = vtk.vtkPolyDataNormals()
        normals.SetInputData(to_poly((back(vertices), faces, None)))
        normals.SplittingOff()
        normals.ConsistencyOff()
        normals.Update()
        made[name] = normals.GetOutput()
    return made


class Window:
    """A window without a display. The light is the one VTK makes: at the camera, but with parallel rays, so that walls
    along the line of sight are black. With `at_eye` its rays start at the eye instead."""

    def __init__(self, wall, size, fov_y_deg, at_eye):
        mapper = vtk.vtkPolyDataMapper()
        mapper.SetInputData(wall)
        mapper.ScalarVisibilityOff()
        actor = vtk.vtkActor()
        actor.SetMapper(mapper)
        actor.GetProperty().SetColor(*COLOUR)
        self.renderer, self.window, self.size = vtk.vtkRenderer(), vtk.vtkRenderWindow(), size
        self.renderer.AddActor(actor)
        self.renderer.SetBackground(0, 0, 0)
        self.window.SetOffScreenRendering(1)
        self.window.SetMultiSamples(4)
        self.window.SetSize(*size)
        self.window.AddRenderer(self.renderer)
        self.renderer.GetActiveCamera().SetViewAngle(fov_y_deg)
        if at_eye:
            light = vtk.vtkLight()
            light.SetLightTypeToHeadlight()
            light.PositionalOn()
            light.SetConeAngle(90)  # everything: no spot
            self.renderer.AddLight(light)

    def draw(self, pose):
        """A pose of the camera path -> [y, x, 3], 8 bits."""
        x, y, z, w = pose["quaternion"]
        up = np.array([2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)])
        back = np.array([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)])
        camera, eye = self.renderer.GetActiveCamera(), np.array(pose["position"])
        camera.SetPosition(*eye)
        camera.SetFocalPoint(*(eye - back))
        camera.SetViewUp(*up)
        camera.SetClippingRange(NEAR_MM, FAR_MM)
        self.window.Render()
        pixels = vtk.vtkUnsignedCharArray()
        self.window.GetPixelData(0, 0, self.size[0] - 1, self.size[1] - 1, 0, pixels, 0)
        return vtk_to_numpy(pixels).reshape(self.size[1], self.size[0], 3)[::-1].copy()

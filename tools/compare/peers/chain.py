"""What one would script today: a CT on disk -> lumen -> wall -> centerline -> a flight of PNG frames.

    chain.py CASE_FOLDER CASE OUT_FOLDER FRAMES WIDTHxHEIGHT

A program of its own, because the whole process is timed, as intima's is. Prints a JSON object."""

import json
import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


def main(folder, name, out, frames, size):
    import dijkstra3d
    import edt
    import numpy as np
    import SimpleITK as sitk
    import vtk
    from scipy.ndimage import gaussian_filter1d

    from inputs import Case
    from job import peak_mb
    from peers.meshes import apply, image, threads
    threads()
    case, out, (width, height) = Case(Path(folder), name), Path(out), map(int, size.split("x"))
    (out / "frames").mkdir(parents=True, exist_ok=True)
    grey, spacing = case.volume("ct")
    spacing, hu = np.array(spacing), case.about()["hu"]

    # lumen
    grown = sitk.ConnectedThreshold(sitk.GetImageFromArray(grey), [case.voxel("start")], -3000, hu, 1)
    mask = sitk.GetArrayFromImage(grown)
    # wall: what is not lumen is lifted above the threshold, so that only the lumen is contoured
    lifted = np.where(mask > 0, grey, np.maximum(grey, hu + 55))
    wall = apply("FlyingEdges3D", image(lifted, spacing), SetValue=(0, hu), ComputeNormalsOff=())
    wall = apply("WindowedSincPolyDataFilter", wall, SetNumberOfIterations=(20,), SetPassBand=(0.01,),
                 NormalizeCoordinatesOn=())
    # A tenth of the faces draws faster than it takes to get there.
    wall = apply("QuadricDecimation", wall, SetTargetReduction=(0.9,))
    wall = apply("PolyDataNormals", wall, SplittingOff=(), AutoOrientNormalsOn=())
    # centerline
    distance = edt.edt(mask.view(bool), anisotropy=tuple(spacing[::-1]), black_border=False, parallel=os.cpu_count())
    cost = np.where(distance > 0, 1e5 * (1 - distance / (1.01 * distance.max())) ** 4 + 1e-2, np.inf)
    ends = [case.voxel(k)[::-1] for k in ("start", "end")]
    path = dijkstra3d.dijkstra(np.asfortranarray(cost.astype(np.float32)), *ends, connectivity=26)
    points = np.asarray(path, float)[:, ::-1] * spacing
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.arange(0, along[-1], 0.5)
    points = gaussian_filter1d(np.stack([np.interp(at, along, c) for c in points.T], 1), 6, axis=0, mode="nearest")
    np.savetxt(out / "centerline.csv", points, delimiter=",", header="x,y,z", comments="")
    # flight
    mapper, actor, renderer, window = (vtk.vtkPolyDataMapper(), vtk.vtkActor(), vtk.vtkRenderer(),
                                       vtk.vtkRenderWindow())
    mapper.SetInputData(wall)
    actor.SetMapper(mapper)
    actor.GetProperty().SetColor(0.93, 0.62, 0.55)
    renderer.AddActor(actor)
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(0)
    window.SetSize(width, height)
    window.AddRenderer(renderer)
    camera, pixels, up = renderer.GetActiveCamera(), vtk.vtkUnsignedCharArray(), np.array([0.0, 0, 1])
    camera.SetViewAngle(90)
    writer = vtk.vtkPNGWriter()
    writer.SetCompressionLevel(1)
    for number, k in enumerate(np.linspace(0.03 * len(points), 0.93 * len(points), frames).astype(int)):
        ahead = points[min(k + 16, len(points) - 1)]
        gaze = (ahead - points[k]) / np.linalg.norm(ahead - points[k])
        up = up - (up @ gaze) * gaze
        up /= np.linalg.norm(up)
        camera.SetPosition(*points[k])
        camera.SetFocalPoint(*ahead)
        camera.SetViewUp(*up)
        camera.SetClippingRange(0.05, 500)
        window.Render()
        window.GetPixelData(0, 0, width - 1, height - 1, 0, pixels, 0)
        frame = vtk.vtkImageData()
        frame.SetDimensions(width, height, 1)
        frame.GetPointData().SetScalars(pixels)
        writer.SetInputData(frame)
        writer.SetFileName(str(out / "frames" / f"frame_{number:05}.png"))
        writer.Write()
    print(json.dumps({"peak_mb": peak_mb()}), flush=True)
    os._exit(0)  # some drivers of OpenGL fall over when they are unloaded


if __name__ == "__main__":
    main(*sys.argv[1:3], sys.argv[3], int(sys.argv[4]), sys.argv[5])

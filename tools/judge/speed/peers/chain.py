"""What one would script today: a volume on disk -> lumen -> wall -> centerline -> a flight of PNG frames.

    chain.py CASE_FOLDER CASE OUT_FOLDER dijkstra3d|vmtk FRAMES WIDTHxHEIGHT

The volume is a CT, or a label map where the case has no threshold. A program of its own, because the whole process is
timed, as intima's is. Prints a JSON object."""

import json
import os
import sys
from pathlib import Path

SPEED = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(SPEED), str(SPEED.parent / "common")]


def main(folder, name, out, route, frames, size):
    import numpy as np
    import vtk

    from inputs import Case
    from job import peak_mb
    from peers.lines import between, cheapest, cropped, longest, smoothed
    from peers.meshes import decimated, threads, windowed_sinc
    from vtk_data import apply, from_poly, image, to_poly
    threads()
    case, out, (width, height) = Case(Path(folder), name), Path(out), map(int, size.split("x"))
    (out / "frames").mkdir(parents=True, exist_ok=True)
    about = case.about()

    # lumen: grown from the start, or the largest piece of the label; from here on in the box around it
    if about["hu"] is None:
        import cc3d
        mask, spacing = case.volume("mask")
        mask, low = cropped(mask)
        mask = cc3d.largest_k(mask, k=1, connectivity=6).astype(np.uint8)
        grey, level = mask, 0.5
    else:
        import SimpleITK as sitk
        (grey, spacing), level = case.volume("ct"), about["hu"]
        grown = sitk.ConnectedThreshold(sitk.GetImageFromArray(grey), [case.voxel("start")], -3000, level, 1)
        mask, low = cropped(sitk.GetArrayFromImage(grown))
        grey = grey[tuple(slice(i, i + n) for i, n in zip(low, mask.shape))]
        # What is not lumen is lifted above the threshold, so that only the lumen is contoured.
        grey = np.where(mask > 0, grey, np.maximum(grey, level + 55))
    low_mm = low[::-1] * np.array(spacing)
    # wall
    wall = apply("FlyingEdges3D", image(grey, spacing, low_mm), SetValue=(0, level), ComputeNormalsOff=(),
                 ComputeScalarsOff=())
    vertices, faces, _ = from_poly(windowed_sinc(wall))
    # A tenth of the faces draws faster than it takes to get there.
    wall = apply("PolyDataNormals", to_poly(decimated(vertices, faces, len(faces) // 10), np.float32), SplittingOff=(),
                 AutoOrientNormalsOn=())
    # centerline
    if route == "vmtk":
        points = longest(between(wall, about["start_mm"], about["end_mm"]))
        start = np.array(about["start_mm"])
        if np.linalg.norm(points[0] - start) > np.linalg.norm(points[-1] - start):
            points = points[::-1]
        points = smoothed(points)
    else:
        ends = (np.array(case.voxel(k)) - low[::-1] for k in ("start", "end"))
        points = cheapest(mask, spacing, *ends) + low_mm
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
    print("\n" + json.dumps({"peak_mb": peak_mb()}), flush=True)  # VMTK does not end its lines
    os._exit(0)  # some drivers of OpenGL fall over when they are unloaded


if __name__ == "__main__":
    main(*sys.argv[1:5], int(sys.argv[5]), sys.argv[6])

"""Slicer module: wall and path of a hollow organ by intima, ready for Slicer's Endoscopy module.

Chooses the lumen of a volume by organ or threshold, or takes a label map, and makes a model of the
wall and a curve with radii. Research and education only; not for diagnosis.
"""

import logging

import ctk
import qt
import slicer
import vtk
from slicer.ScriptedLoadableModule import (
    ScriptedLoadableModule,
    ScriptedLoadableModuleLogic,
    ScriptedLoadableModuleTest,
    ScriptedLoadableModuleWidget,
)
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray

import numpy as np

from conversion import to_ras, volume_arguments

CHOICES = ("airway", "colon", "vessel", "threshold", "label map")


class Intima(ScriptedLoadableModule):
    """What Slicer shows of the module."""

    def __init__(self, parent):
        """Name, category and text."""
        super().__init__(parent)
        parent.title = "Intima"
        parent.categories = ["Endoscopy"]
        parent.dependencies = []
        parent.contributors = []
        parent.helpText = "Wall and path of a hollow organ. Research and education only; not for diagnosis."


class IntimaWidget(ScriptedLoadableModuleWidget):
    """The panel."""

    def setup(self):
        """Makes the panel."""
        super().setup()
        box = ctk.ctkCollapsibleButton()
        box.text = "Lumen"
        self.layout.addWidget(box)
        form = qt.QFormLayout(box)
        self.volume = slicer.qMRMLNodeComboBox()
        self.volume.nodeTypes = ["vtkMRMLScalarVolumeNode", "vtkMRMLLabelMapVolumeNode"]
        self.volume.setMRMLScene(slicer.mrmlScene)
        form.addRow("Volume", self.volume)
        self.choice = qt.QComboBox()
        self.choice.addItems(list(CHOICES))
        form.addRow("Lumen by", self.choice)
        self.range = ctk.ctkRangeWidget()
        self.range.minimum, self.range.maximum = -1024, 3071
        self.range.minimumValue, self.range.maximumValue = -1024, -600
        form.addRow("Threshold", self.range)
        self.tree = qt.QCheckBox()
        form.addRow("All branches", self.tree)
        self.button = qt.QPushButton("Make wall and path")
        self.button.clicked.connect(self.make)
        self.layout.addWidget(self.button)
        self.layout.addStretch(1)

    def make(self):
        """Runs the logic; an error is shown."""
        settings = {"tree": self.tree.checked}
        choice = self.choice.currentText
        if choice == "threshold":
            settings["threshold"] = (self.range.minimumValue, self.range.maximumValue)
        elif choice != "label map":
            settings["organ"] = choice
        with slicer.util.tryWithErrorDisplay("intima failed", waitCursor=True):
            IntimaLogic().run(self.volume.currentNode(), choice == "label map", **settings)


class IntimaLogic(ScriptedLoadableModuleLogic):
    """The work, without a panel."""

    def run(self, node, is_labels, **settings):
        """Makes a model and one curve a branch of a volume node; returns them."""
        import intima

        if node is None:
            raise ValueError("choose a volume")
        matrix = vtk.vtkMatrix4x4()
        node.GetIJKToRASMatrix(matrix)
        array = slicer.util.arrayFromVolume(node)
        volume = intima.Volume(**volume_arguments(array, slicer.util.arrayFromVTKMatrix(matrix)))
        source = {"mask": volume} if is_labels else {"image": volume}
        session = intima.Session(**source, **settings)
        model = self.model(session.wall(), node.GetName() + " wall")
        curves = [
            self.curve(branch, f"{node.GetName()} path {n}")
            for n, branch in enumerate(session.centerline().branches)
        ]
        for note in session.warnings():
            logging.warning(note)
        return model, curves

    def model(self, mesh, name):
        """A model node of a mesh."""
        points = vtk.vtkPoints()
        points.SetData(numpy_to_vtk(to_ras(mesh.vertices), deep=True))
        rows = np.insert(mesh.faces.astype(np.int64), 0, 3, axis=1)
        cells = vtk.vtkCellArray()
        cells.SetCells(len(rows), numpy_to_vtkIdTypeArray(rows.ravel(), deep=True))
        data = vtk.vtkPolyData()
        data.SetPoints(points)
        data.SetPolys(cells)
        normals = numpy_to_vtk(to_ras(mesh.normals), deep=True)
        normals.SetName("Normals")
        data.GetPointData().SetNormals(normals)
        model = slicer.modules.models.logic().AddModel(data)
        model.SetName(name)
        return model

    def curve(self, branch, name):
        """A curve node of a branch, with the radius as a measurement of its points."""
        curve = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLMarkupsCurveNode", name)
        slicer.util.updateMarkupsControlPointsFromArray(curve, to_ras(branch.points))
        radius = numpy_to_vtk(np.ascontiguousarray(branch.radius), deep=True)
        radius.SetName("Radius")
        measurement = slicer.vtkMRMLStaticMeasurement()
        measurement.SetName("Radius")
        measurement.SetUnits("mm")
        measurement.SetControlPointValues(radius)
        curve.AddMeasurement(measurement)
        return curve


class IntimaTest(ScriptedLoadableModuleTest):
    """A tube as a label map."""

    def runTest(self):
        """Makes its wall and path."""
        array = np.zeros((40, 20, 20), np.uint8)
        array[2:38, 6:14, 6:14] = 1
        node = slicer.util.addVolumeFromArray(array, nodeClassName="vtkMRMLLabelMapVolumeNode")
        model, curves = IntimaLogic().run(node, is_labels=True)
        assert model.GetPolyData().GetNumberOfCells() > 100
        assert len(curves) == 1 and curves[0].GetNumberOfControlPoints() > 10

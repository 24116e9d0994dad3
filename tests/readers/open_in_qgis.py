"""Open files in QGIS and print what it makes of them as JSON; run by the Python that QGIS belongs to.

QT_QPA_PLATFORM=offscreen /usr/bin/python3 open_in_qgis.py PICTURE.png FILE...
"""

import json
import sys

from qgis.core import (
    QgsApplication,
    QgsMapRendererParallelJob,
    QgsMapSettings,
    QgsProviderRegistry,
    QgsRasterLayer,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import QSize
from qgis.PyQt.QtGui import QColor

WIDTH, HEIGHT = 900, 700


def layers_of(path):
    """Open all layers of a file."""
    if path.endswith((".tif", ".tiff")):
        return [QgsRasterLayer(path, path.rpartition("/")[2])]
    found = QgsProviderRegistry.instance().querySublayers(path)
    names = [sublayer.name() for sublayer in found]
    return [QgsVectorLayer(f"{path}|layername={name}", name, "ogr") for name in names]


def told(layer):
    """Return what QGIS makes of a layer."""
    told = {"name": layer.name(), "valid": layer.isValid(), "crs": layer.crs().authid()}
    if isinstance(layer, QgsVectorLayer):
        renderer = layer.renderer()
        told["rows"] = layer.featureCount()
        told["spatial"] = layer.isSpatial()
        told["renderer"] = renderer.type() if renderer else None
        told["classes"] = len(renderer.categories()) if renderer and renderer.type() == "categorizedSymbol" else 0
        told["fields"] = [field.name() for field in layer.fields()]
    return told


def draw(layers, picture):
    """Draw layers as the map canvas would, the first on top."""
    settings = QgsMapSettings()
    settings.setLayers(layers)
    settings.setDestinationCrs(layers[0].crs())
    settings.setBackgroundColor(QColor("white"))
    settings.setOutputSize(QSize(WIDTH, HEIGHT))
    settings.setExtent(settings.fullExtent())
    job = QgsMapRendererParallelJob(settings)
    job.start()
    job.waitForFinished()
    job.renderedImage().save(picture)


def show(picture, files):
    """Open files, draw all that has a place, return what was found; all layers are gone when it returns."""
    opened = {path: layers_of(path) for path in files}
    shown = [layer for layers in opened.values() for layer in layers if layer.isValid() and layer.isSpatial()]
    later_first = [layer for layer in reversed(shown) if layer.name() != "active_areas"]
    draw(sorted(later_first, key=lambda layer: getattr(layer, "geometryType", lambda: 9)()), picture)  # points on top
    return {path: [told(layer) for layer in layers] for path, layers in opened.items()}


def main(picture, *files):
    """Start QGIS without a window, ask it, print what it says."""
    program = QgsApplication([], False)
    program.initQgis()
    answer = show(picture, files)
    program.exitQgis()
    sys.stdout.write(json.dumps(answer) + "\n")


main(*sys.argv[1:])

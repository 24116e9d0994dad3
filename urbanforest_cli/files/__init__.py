"""Files to core objects and back; nothing is computed here.

Importing this package takes the drivers out of GDAL that follow references from a file to other files or hosts.
It stands here because GDAL reads these settings once, when a package that carries it is imported.
"""

import logging
import os

_LINKING_DRIVERS = {
    "GDAL_SKIP": "VRT,WMS,WCS,WMTS",
    "OGR_SKIP": "OGR_VRT,WFS,OAPIF,OGCAPI,CSW,HTTP,GDALG,Elasticsearch,Carto,AmigoCloud,PLSCENES,NGW,EEDA,ADBC,"
    "GPSBabel",
}
for _name, _drivers in _LINKING_DRIVERS.items():
    os.environ[_name] = ",".join(filter(None, (os.environ.get(_name), _drivers)))
os.environ["CPL_VSIL_CURL_ALLOWED_FILENAME"] = "/none"
os.environ["PROJ_NETWORK"] = "OFF"
# The GDAL of rasterio has fewer drivers than that of pyogrio, and tells of each that it cannot take out.
logging.getLogger("rasterio._env").addFilter(lambda record: "to unload from GDAL_SKIP" not in record.getMessage())

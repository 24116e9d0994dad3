"""Whatever is no image, or would hurt to read, is refused before a pixel is read, and nothing else is opened for it."""

import os
import sqlite3
import struct
import warnings
import zlib

import numpy as np
import pytest
import rasterio

from tests.files.rasters import PLACE, UTM, colours, write_raster
from urbanforest_cli.core.errors import InputError, LimitError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files import image_checks
from urbanforest_cli.files.image_checks import open_raster, raster_driver


def opened(path):
    with open_raster(path, Notices()) as (dataset, _):
        return dataset.driver


def test_formats_are_told_by_first_bytes_whatever_the_name(tmp_path):
    for driver in ("GTiff", "PNG", "JPEG", "JP2OpenJPEG"):
        with warnings.catch_warnings(action="ignore"):
            path = write_raster(tmp_path / "a.txt", colours(), driver=driver, place=None, crs=None)
        assert opened(path) == driver


VRT = '<VRTDataset rasterXSize="1" rasterYSize="1"><VRTRasterBand dataType="Byte" band="1"><SimpleSource>' \
      "<SourceFilename>{}</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>"  # fmt: skip
WRONG = {
    "vrt": VRT.format("/etc/passwd").encode(),
    "vrt behind blanks": b"\n \t" + VRT.format("/etc/passwd").encode(),
    "wms": b"<GDAL_WMS><Service name='TMS'><ServerUrl>http://127.0.0.1:9/</ServerUrl></Service></GDAL_WMS>",
    "zip": b"PK\x03\x04" + bytes(50),
    "page": b"\xef\xbb\xbf<!doctype html><title>404</title>",
    "json": b'{"type": "FeatureCollection"}',
    "pdf": b"%PDF-1.4 ",
    "gif": b"GIF89a" + bytes(40),
    "bmp": b"BM" + bytes(60),
    "text": b"ncols 4\nnrows 4\n",
    "zeros": bytes(100),
    "half a number": b"II",
    "empty": b"",
}


@pytest.mark.parametrize("kind", WRONG)
def test_what_is_no_image_is_refused(tmp_path, kind):
    path = tmp_path / "image.tif"
    path.write_bytes(WRONG[kind])
    with pytest.raises(InputError, match=r"image\.tif"):
        raster_driver(path)


def test_what_is_no_file_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.tif")
    (tmp_path / "folder.tif").mkdir()
    (tmp_path / "loop.tif").symlink_to("loop.tif")
    (tmp_path / "gone.tif").symlink_to("nowhere")
    for name in ("pipe.tif", "folder.tif", "loop.tif", "gone.tif", "absent.tif", "a\0b.tif", "x" * 300 + ".tif"):
        with pytest.raises(InputError):
            opened(tmp_path / name)
    for name in ("/dev/zero", "/dev/null", "/vsicurl/http://127.0.0.1:9/a.tif", "/vsizip/a.zip/a.tif",
                 "http://127.0.0.1:9/a.tif", "zip+file:///a.zip!a.tif", "GTIFF_DIR:1:a.tif"):  # fmt: skip
        with pytest.raises(InputError):
            opened(image_checks.Path(name))


def test_links_to_images_are_followed(tmp_path):
    write_raster(tmp_path / "a.tif", colours())
    (tmp_path / "link").symlink_to("a.tif")
    assert opened(tmp_path / "link") == "GTiff"


@pytest.mark.parametrize("suffix", [".ovr", ".msk"])
@pytest.mark.parametrize("kind", ["vrt", "empty", "database", "pipe"])
def test_files_beside_it_that_could_lead_elsewhere_are_refused(tmp_path, suffix, kind):
    path = write_raster(tmp_path / "a.tif", colours())
    beside = tmp_path / f"a.tif{suffix}"
    if kind == "pipe":
        os.mkfifo(beside)
    elif kind == "database":
        with sqlite3.connect(beside) as database:
            database.execute("CREATE TABLE t (x)")
        database.close()
    else:
        beside.write_bytes(WRONG[kind])
    with pytest.raises(InputError, match=rf"a\.tif\{suffix}"):
        opened(path)


def test_metadata_beside_it_that_names_another_file_is_refused(tmp_path):
    path = write_raster(tmp_path / "a.tif", colours())
    beside = tmp_path / "a.tif.aux.xml"
    beside.write_text("<PAMDataset><SRS>EPSG:32611</SRS></PAMDataset>")
    assert opened(path) == "GTiff"
    beside.write_text('<PAMDataset><Metadata domain="OVERVIEWS"><MDI key="OVERVIEW_FILE">/etc/passwd</MDI></Metadata>'
                      "</PAMDataset>")  # fmt: skip
    with pytest.raises(InputError, match="points to another file"):
        opened(path)
    beside.write_text('<!DOCTYPE x [<!ENTITY y SYSTEM "/etc/passwd">]><PAMDataset/>')
    with pytest.raises(InputError, match="points to another file"):
        opened(path)


def test_outside_masks_that_are_tiffs_are_taken(tmp_path):
    path = write_raster(tmp_path / "a.tif", colours())
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False), rasterio.open(path, "r+") as file:
        file.write_mask(colours()[0] > 99)
    assert (tmp_path / "a.tif.msk").exists()
    with open_raster(path, Notices()) as (dataset, _):
        assert np.array_equal(dataset.read_masks(1) > 0, colours()[0] > 99)


def sparse(path, width, height, **options):
    with rasterio.open(
        path, "w", driver="GTiff", width=width, height=height, crs=UTM, transform=rasterio.Affine(*PLACE),
        **({"count": 3, "dtype": "uint8", "SPARSE_OK": True} | options),
    ):  # fmt: skip
        return path


def test_sizes_beyond_the_limits_are_refused(tmp_path):
    cases = {
        "bands": {"width": 10, "height": 10, "count": 17},
        "too large": {"width": 1_100_000, "height": 10, "tiled": True},
        "parts": {"width": 30_000, "height": 30_000, "tiled": True, "blockxsize": 8192, "blockysize": 8192},
        "far more pixels": {"width": 100_000, "height": 100_000, "tiled": True, "blockxsize": 8192, "blockysize": 8192,
                            "count": 1},
    }  # fmt: skip
    for what, options in cases.items():
        with pytest.raises(LimitError, match=rf"a\.tif: .*{what}"):
            opened(sparse(tmp_path / "a.tif", **options))


def test_large_images_that_can_be_read_in_parts_pass(tmp_path):
    assert opened(sparse(tmp_path / "a.tif", 150_000, 150_000, tiled=True)) == "GTiff"
    assert opened(sparse(tmp_path / "b.tif", 60_000, 2_000, dtype="uint16", count=16)) == "GTiff"


def png(width: int, height: int, interlaced: bool) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, interlaced)
    filler = b"".join(chunk(b"tEXt", b"a\0" + b"b" * 5000) for _ in range(2))
    body = chunk(b"IHDR", head) + filler + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def test_pictures_that_only_unpack_whole_are_refused_when_large(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(png(20_000, 20_000, interlaced=True))
    with pytest.raises(LimitError, match="unpacked whole"):
        opened(path)
    path.write_bytes(png(20_000, 20_000, interlaced=False))
    assert opened(path) == "PNG"


def test_progressive_jpegs_are_refused_when_large(tmp_path, monkeypatch):
    values = colours(64, 64)
    kinds = {}
    for name, progressive in (("plain.jpg", "OFF"), ("coarse.jpg", "ON")):
        with warnings.catch_warnings(action="ignore"):
            kinds[name] = write_raster(tmp_path / name, values, driver="JPEG", PROGRESSIVE=progressive)
    assert {opened(path) for path in kinds.values()} == {"JPEG"}
    monkeypatch.setattr(image_checks, "WHOLE_MOST_BYTES", 1000)
    assert opened(kinds["plain.jpg"]) == "JPEG"
    with pytest.raises(LimitError, match="unpacked whole"):
        opened(kinds["coarse.jpg"])


@pytest.mark.parametrize("dtype", ["int64", "uint64", "complex64", "complex_int16", "int8"])
def test_samples_that_are_no_colours_are_refused(tmp_path, dtype):
    values = colours(bands=1).astype("complex64" if "complex" in dtype else dtype)
    path = sparse(tmp_path / "a.tif", 60, 40, dtype=dtype, count=1)
    with rasterio.open(path, "r+") as file:
        file.write(values)
    with pytest.raises(InputError, match=r"a\.tif: samples of this type"):
        opened(path)


def test_texts_that_are_not_utf8_print_no_traceback(tmp_path, capfd):
    raw = write_raster(tmp_path / "a.jp2", colours(), driver="JP2OpenJPEG", GeoJP2="NO").read_bytes()
    damaged = raw.replace(b"<gml:RectifiedGridCoverage ", b"<gml:RectifiedGridCovera\xcfe ", 1)
    assert damaged != raw
    (tmp_path / "a.jp2").write_bytes(damaged)
    opened(tmp_path / "a.jp2")
    assert "Traceback" not in capfd.readouterr().err


def test_an_image_is_closed_whatever_happens(tmp_path):
    path = write_raster(tmp_path / "a.tif", colours())
    context = open_raster(path, Notices())
    dataset, _ = context.__enter__()
    assert not context.__exit__(KeyError, KeyError(), None)
    assert dataset.closed
